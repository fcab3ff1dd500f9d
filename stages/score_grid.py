"""Where in an image the cells of a network's scores lie, exactly.

A picture is fitted to the network's input by stretching or padding (`fit`), and the network answers
on a coarser grid whose cells lie on the input's pixels in one of two ways: evenly divided, or with
`align_corners` from the middle of its first pixel to the middle of its last. Both become one thing:
the rectangle of the image that the cells divide evenly, which may reach beyond the image.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stages.kernels.network_input import fitted


@dataclass(frozen=True, slots=True)
class ScoreGrid:
    """How a network's output lies on its input, and which cells of it are taken."""

    size: tuple[int, int]  #: (width, height) of the input
    align_corners: bool
    stride: int = 1  #: of a map of labels only each so manieth cell is taken

    @classmethod
    def of(cls, input_shape: tuple[int, ...], head: Mapping[str, Any]) -> ScoreGrid:
        """The grid of a head of kind `scores` or `label_map`."""
        aligned = bool(head.get("align_corners", False))
        stride = head.get("stride", 1) if head["kind"] == "label_map" else 1
        return cls((input_shape[1], input_shape[0]), aligned, stride)

    def taken(self, cells: int) -> NDArray[np.int64]:
        """Which of `cells` in a row are taken: from the first on, or each middle of `stride`."""
        if self.align_corners:
            first, count = 0, 1 + math.ceil((cells - 1) / self.stride)
        else:
            first, count = self.stride // 2, math.ceil(cells / self.stride)
        return np.minimum(first + self.stride * np.arange(count), cells - 1)

    def pads(self, size: tuple[int, int]) -> bool:
        """Whether a picture of `size` (width, height) is padded and not stretched.

        Networks with aligned corners take a multiple of their stride plus one pixels, 849 x 481,
        and cameras give a multiple, 848 x 480. The last row and column twice keep every pixel
        where it is, which costs less and is more exact than stretching by a thousandth.
        """
        missing = (self.size[0] - size[0], self.size[1] - size[1])
        return self.align_corners and min(missing) >= 0 and max(missing) == 1

    def fit(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The picture (height, width[, 3]) in the input's size; one of that size as it is."""
        height, width = picture.shape[:2]
        if not self.pads((width, height)):
            return fitted(picture, self.size)
        right, bottom = self.size[0] - width, self.size[1] - height
        padded = cv2.copyMakeBorder(picture, 0, bottom, 0, right, cv2.BORDER_REPLICATE)
        return np.asarray(padded, dtype=np.uint8)

    def rect(
        self, window: tuple[int, int, int, int], output: tuple[int, int]
    ) -> tuple[float, float, float, float]:
        """What the taken cells of an `output` (rows, columns) divide evenly when the `window` (x0
        y0 x1 y1) of an image was fitted; both in pixel edges of that image."""
        x0, y0, x1, y1 = window
        pads = self.pads((x1 - x0, y1 - y0))
        left, right = self._edges(self.size[0], output[1])
        top, bottom = self._edges(self.size[1], output[0])
        across = 1.0 if pads else (x1 - x0) / self.size[0]
        down = 1.0 if pads else (y1 - y0) / self.size[1]
        return x0 + left * across, y0 + top * down, x0 + right * across, y0 + bottom * down

    def _edges(self, pixels: int, cells: int) -> tuple[float, float]:
        """Where the taken of `cells` begin and end along the input, in its pixel edges."""
        if self.align_corners and cells > 1:
            step = self.stride * (pixels - 1) / (cells - 1)
            begin = (1.0 - step) / 2  # the middle of the first pixel is the middle of the cell
        else:
            step, begin = self.stride * pixels / cells, 0.0
        return begin, begin + len(self.taken(cells)) * step
