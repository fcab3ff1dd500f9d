"""Fused semantics laid over the camera's image: what a person at a ground station looks at."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.message import Message
from pipeline.stage import Stage
from stages.camera_image import eight_bit
from stages.fused import FusedImage
from stages.kernels.image_fusion import colorize
from stages.kernels.render import blend_classes
from stages.taxonomy import load_taxonomy
from stages.types import Image


class DrawFused(Stage):
    """A picture of each fused image, as an `Image` of the same camera."""

    def __init__(self, *, share: float = 0.5) -> None:
        """`share` of the class color in the blend, 0..1."""
        check_share(share)
        self._share = share

    def process(self, fused: Message[FusedImage], image: Message[Image] | None = None) -> Image:
        picture = drawn(fused.payload, image.payload if image else None, self._share)
        return Image(picture, fused.payload.camera)


def check_share(share: float) -> None:
    """Raises ValueError for a share outside 0..1."""
    if not 0 <= share <= 1:
        raise ValueError(f"share must lie in 0..1, not {share}")


def drawn(fused: FusedImage, image: Image | None, share: float) -> NDArray[np.uint8]:
    """The classes over the image (background leaves it as it is), or alone: (height, width, 3)
    RGB."""
    colors = load_taxonomy().colors
    if image is None:
        alone: NDArray[np.uint8] = colorize(fused.mask, colors)
        return alone
    pixels = eight_bit(image)
    color = pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)
    blended: NDArray[np.uint8] = blend_classes(color, fused.mask, colors, share)
    return blended
