"""Boxes that a detector states cell by cell of a grid over its picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stages.kernels.boxes import Boxes, Found, exp_size, from_center
from stages.kernels.scores import best_class, sigmoid

#: FastestDet's score is objectness^0.6 * class^0.4.
OBJECTNESS_POWER = 0.6


def decode_fastestdet(
    cells: NDArray[np.float32],
    row: NDArray[np.intp],
    column: NDArray[np.intp],
    shape: tuple[int, int],
) -> Found:
    """FastestDet's cells (n, 5 + classes): objectness, x, y, w, h, class probabilities.

    `row`, `column` (n,) say where they are in the grid of `shape` (rows, columns). Center = (cell +
    tanh x) / cells, size = sigmoid w.
    """
    rows, columns = shape
    best, likely = best_class(cells[:, 5:])
    # An 8-bit file can give a hair below 0 or above 1.
    objectness, likely = np.clip(cells[:, 0], 0, 1), np.clip(likely, 0, 1)
    scores = objectness**OBJECTNESS_POWER * likely ** (1 - OBJECTNESS_POWER)
    boxes = from_center(
        (column + np.tanh(cells[:, 1])) / columns,
        (row + np.tanh(cells[:, 2])) / rows,
        sigmoid(cells[:, 3]),
        sigmoid(cells[:, 4]),
    )
    return boxes, best, scores.astype(np.float32)


def yolo_grid(strides: Sequence[int], picture: tuple[int, int]) -> NDArray[np.float64]:
    """(n, 3) column, row, stride of every cell: maps of these strides (pixels), one after another,
    row by row over a picture (width, height)."""
    grids = []
    for stride in strides:
        row, column = np.indices((picture[1] // stride, picture[0] // stride)).reshape(2, -1)
        grids.append(np.stack([column, row, np.full_like(row, stride)], axis=1))
    return np.concatenate(grids).astype(np.float64)


def decode_yolo(boxes: NDArray[np.float32], grid: NDArray[np.float64] | None) -> Boxes:
    """Corners, in pixels, of (n, 4) center x, y and width, height.

    With the cells' `grid` (n, 3) column, row, stride: center = (cell + x) * stride, size = exp(w) *
    stride, as YOLOX leaves it to the host. Without, they are pixels already.
    """
    x, y, width, height = boxes.T.astype(np.float64)
    if grid is not None:
        column, row, stride = grid.T
        x, y = (x + column) * stride, (y + row) * stride
        width, height = exp_size(width) * stride, exp_size(height) * stride
    return from_center(x, y, width, height)
