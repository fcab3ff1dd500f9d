"""Head of CenterNet: objects as peaks of a heat map, with their sizes beside it."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.model import Tensor, Tensors
from stages.heads.head import Decoder, Head, output, output_map, rows
from stages.kernels.boxes import Found, exp_size, from_center
from stages.kernels.center_peaks import peaks
from stages.kernels.scores import logit, may_reach, sigmoid


class CenterNet(Head):
    """Outputs `heat` (1, rows, columns, classes), `size` and `offset` (1, rows, columns, 2).

    An object is where the heat of its class is the greatest of 3x3 cells; there, center = cell +
    `cell_center` + offset and size, both in cells of the map, whose stride is the picture's size by
    the map's. `heat` of the settings: "sigmoid" of logits, or the "probability" itself; `order` of
    the pairs: "xy" (width, height) or "yx"; `log_size`: the size is its exponent. The outputs have
    no duplicates, so `max_iou: 1` of the stage leaves neighbors that stand close together.
    """

    kind: Literal["centernet"]
    heat: Literal["sigmoid", "probability"] = "sigmoid"
    order: Literal["xy", "yx"] = "xy"
    log_size: bool = False
    cell_center: float = 0.0

    def decoder(self, picture: tuple[int, int], min_score: float) -> Decoder:
        least = logit(min_score) if self.heat == "sigmoid" else min_score

        def decode(outputs: Tensors) -> Found:
            heat = output_map(outputs, "heat", 1)
            shape = heat.array.shape
            warm = may_reach(heat.array, heat.scale, heat.zero_point, least)
            row, column, kind = peaks(heat.array, warm)
            score = rows(heat, (row, column, kind))
            if self.heat == "sigmoid":
                score = sigmoid(score)
            shift_x, shift_y = self._pairs(output(outputs, "offset", *shape[:2], 2), row, column)
            width, height = self._pairs(output(outputs, "size", *shape[:2], 2), row, column)
            if self.log_size:
                width, height = exp_size(width), exp_size(height)
            x = (column + self.cell_center + shift_x) / shape[1]
            y = (row + self.cell_center + shift_y) / shape[0]
            boxes = from_center(x, y, width / shape[1], height / shape[0])
            return boxes, kind.astype(np.int64), score

        return decode

    def _pairs(
        self, maps: Tensor, row: NDArray[np.intp], column: NDArray[np.intp]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """x and y (n,) of the pairs at the cells."""
        pairs = rows(maps, (row, column)).astype(np.float64)
        x, y = (pairs[:, 0], pairs[:, 1]) if self.order == "xy" else (pairs[:, 1], pairs[:, 0])
        return x, y
