"""Head of FastestDet: one grid of cells, each with one object at most."""

from __future__ import annotations

from typing import Literal

import numpy as np

from pipeline.model import Tensors
from stages.heads.head import Decoder, Head, output_map, rows
from stages.kernels.boxes import Found
from stages.kernels.grid_boxes import OBJECTNESS_POWER, decode_fastestdet
from stages.kernels.scores import may_reach


class FastestDet(Head):
    """Output `grid` (1, rows, columns, 5 + classes): objectness, x, y, w, h, probabilities."""

    kind: Literal["fastestdet"]

    def decoder(self, picture: tuple[int, int], min_score: float) -> Decoder:
        least = min_score ** (1 / OBJECTNESS_POWER)  # what a class of probability 1 needs

        def decode(outputs: Tensors) -> Found:
            grid = output_map(outputs, "grid", 6)
            above = may_reach(grid.array[..., 0], grid.scale, grid.zero_point, least)
            row, column = np.nonzero(above)
            return decode_fastestdet(rows(grid, (row, column)), row, column, grid.array.shape[:2])

        return decode
