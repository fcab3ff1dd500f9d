"""Pictures for a network: the part of an image it shall see, in its size and color order."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def fitted(
    image: NDArray[np.uint8], size: tuple[int, int], *, letterbox: bool = False
) -> NDArray[np.uint8]:
    """The image in `size` (width, height), stretched; with `letterbox` in its own aspect on gray.

    An image of the right size is returned as it is.
    """
    height, width = image.shape[:2]
    if (width, height) == size:
        return image
    left, top, inner_width, inner_height = _inner((width, height), size, letterbox)
    inner = _resized(image, (inner_width, inner_height))
    if (inner_width, inner_height) == size:
        return inner
    picture = np.full((size[1], size[0], *image.shape[2:]), 114, dtype=np.uint8)
    picture[top : top + inner_height, left : left + inner_width] = inner
    return picture


def placement(
    image_size: tuple[int, int], size: tuple[int, int], *, letterbox: bool = False
) -> NDArray[np.float64]:
    """Where `fitted` puts the image: (4,) gain x, gain y, shift x, shift y.

    picture = image * gain + shift, in pixel edges; sizes are (width, height).
    """
    left, top, width, height = _inner(image_size, size, letterbox)
    return np.array([width / image_size[0], height / image_size[1], left, top])


def _inner(
    image_size: tuple[int, int], size: tuple[int, int], letterbox: bool
) -> tuple[int, int, int, int]:
    """Left, top, width and height of the image within the picture."""
    if not letterbox:
        return 0, 0, *size
    gain = min(size[0] / image_size[0], size[1] / image_size[1])
    width, height = (max(1, round(length * gain)) for length in image_size)
    return (size[0] - width) // 2, (size[1] - height) // 2, width, height


def in_color_order(image: NDArray[Any], color: str) -> NDArray[Any]:
    """(height, width, 3) RGB or (height, width) gray as (height, width, channels) of `color`.

    `color` is "rgb", "bgr" or "gray"; the result is a view where that is possible.
    """
    if color == "gray":
        gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
        return np.asarray(gray)[..., None]
    if image.ndim == 2:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2RGB))
    return image[..., ::-1] if color == "bgr" else image


def gamma_table(gamma: float) -> NDArray[np.uint8]:
    """(256,) 255 * (value / 255) ** gamma; below 1 opens the shadows."""
    return np.rint(255.0 * (np.arange(256) / 255.0) ** gamma).astype(np.uint8)


def _resized(image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    gain = max(size[0] / image.shape[1], size[1] / image.shape[0])
    shrink = max(image.shape[1] / size[0], image.shape[0] / size[1])
    if shrink > 2:  # linear would skip pixels and flicker
        method = cv2.INTER_AREA
    elif gain > 1.5:  # half-size KITTI: 95 % of the facade as at full size, linear 81 to 95 %
        method = cv2.INTER_CUBIC
    else:
        method = cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, size, interpolation=method), dtype=np.uint8)
