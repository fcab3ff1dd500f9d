"""Anchors of single-shot detectors (SSD), and boxes stated relative to them.

An anchor is center y, center x, height, width in parts of the network's picture, as the TensorFlow
Object Detection API orders them. In a picture that is not square, forms are parts of its shorter
side.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stages.kernels.boxes import Boxes, exp_size, from_center


class Multiscale(NamedTuple):
    """What `multiscale_anchors` wants to know beside the picture."""

    levels: tuple[int, int]
    base: float
    ratios: tuple[float, ...]
    per_octave: int


#: Of the detectors that are trained here: 12, 24, 48 and 96 px at strides 4 to 32, three forms. The
#: usual ones (stride 16 and more, from 32 px) overlap no person of thermal images by half.
SMALL_OBJECTS = Multiscale((2, 5), 3.0, (1.0, 0.5, 2.0), 1)
#: Of TensorFlow's object detection: how regressions are scaled.
CODER = (10.0, 10.0, 5.0, 5.0)


def ssd_anchors(
    maps: Sequence[tuple[int, int]],
    scales: Sequence[float],
    ratios: Sequence[float],
    picture: tuple[int, int],
    *,
    reduce_lowest: bool = True,
) -> NDArray[np.float32]:
    """(n, 4) anchors of the "SSD anchor generator"; order: map, row, column, form.

    Every map (rows, columns) with scale s has its `ratios` (width / height) and ratio 1 at sqrt(s *
    next scale). With `reduce_lowest` the first has only 0.1 at ratio 1, s at 2 and s at 1/2.
    `picture` is (width, height), pixels.
    """
    short = min(picture)
    following = [*scales[1:], 1.0]
    anchors = []
    for number, (cells, scale, then) in enumerate(zip(maps, scales, following, strict=True)):
        if number == 0 and reduce_lowest:
            forms = [(0.1, 1.0), (scale, 2.0), (scale, 0.5)]
        else:
            forms = [(scale, ratio) for ratio in ratios]
            forms.append((float(np.sqrt(scale * then)), 1.0))
        sizes = _sizes(forms) * (short / picture[1], short / picture[0])
        anchors.append(_tiled((np.indices(cells).transpose(1, 2, 0) + 0.5) / cells, sizes))
    return np.concatenate(anchors).astype(np.float32)


def multiscale_anchors(
    levels: tuple[int, int],
    base: float,
    ratios: Sequence[float],
    per_octave: int,
    picture: tuple[int, int],
) -> NDArray[np.float32]:
    """(n, 4) anchors of the "multiscale anchor generator" of feature pyramids.

    Level l, from `levels[0]` to `levels[1]`, is a map of stride 2^l with forms of `base` * 2^l *
    2^(i / per_octave) pixels; order: level, row, column, ratio, i. `picture` is (width, height).
    """
    width, height = picture
    steps = 2.0 ** (np.arange(per_octave) / per_octave)
    forms = _sizes([(base * step, ratio) for ratio in ratios for step in steps])
    anchors = []
    for level in range(levels[0], levels[1] + 1):
        stride = 2**level
        cells = -(-height // stride), -(-width // stride)
        # The generator's rule: the first center is in the middle of its cell only where the cells
        # fill the picture exactly.
        first = [stride / 2 if length % stride == 0 else 0.0 for length in (height, width)]
        centers = np.indices(cells).transpose(1, 2, 0) * stride + first
        anchors.append(_tiled(centers / (height, width), forms * stride / (height, width)))
    return np.concatenate(anchors).astype(np.float32)


def decode_anchored(
    regression: NDArray[np.float32],
    anchors: NDArray[np.float32],
    coder: tuple[float, float, float, float],
) -> Boxes:
    """Boxes of regressions (n, 4) ty tx th tw to their anchors (n, 4).

    y = ty / coder[0] * height + y of the anchor, height = exp(th / coder[2]) * height of the
    anchor; x and width with coder[1] and coder[3]. The usual `coder` is 10, 10, 5, 5.
    """
    ty, tx, th, tw = regression.T.astype(np.float64)
    y, x, height, width = anchors.T.astype(np.float64)
    return from_center(
        tx / coder[1] * width + x,
        ty / coder[0] * height + y,
        exp_size(tw / coder[3]) * width,
        exp_size(th / coder[2]) * height,
    )


def _sizes(forms: Sequence[tuple[float, float]]) -> NDArray[np.float64]:
    """(n, 2) height, width of forms given by scale and ratio width / height, area scale^2."""
    return np.array([(s / np.sqrt(ratio), s * np.sqrt(ratio)) for s, ratio in forms])


def _tiled(centers: NDArray[np.float64], sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """(rows * columns * forms, 4): every form at every center (rows, columns, 2)."""
    centers = centers.reshape(-1, 2)
    return np.hstack([np.repeat(centers, len(sizes), axis=0), np.tile(sizes, (len(centers), 1))])
