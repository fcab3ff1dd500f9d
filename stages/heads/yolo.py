"""Head of the YOLO family: rows of center, size and class probabilities."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from pipeline.model import Tensor, Tensors
from stages.heads.head import Decoder, Head, output, rows, wrong_shape
from stages.kernels.boxes import Found
from stages.kernels.grid_boxes import decode_yolo, yolo_grid
from stages.kernels.scores import best_class, may_reach


class Yolo(Head):
    """Output `rows` (1, n, 4 + classes) x, y, width, height and probabilities.

    With `objectness` (YOLOv5, YOLOX) it stands before the classes and multiplies them. With
    `transposed` (YOLOv8 and later) the output is (1, 4 + classes, n). `unit` is that of the boxes:
    "pixels" of the picture, or "parts" of it. `strides` (YOLOX) says that they are raw numbers of
    the cells of maps with these strides.
    """

    kind: Literal["yolo"]
    objectness: bool = True
    transposed: bool = False
    unit: Literal["pixels", "parts"] = "pixels"
    strides: tuple[Annotated[int, Field(ge=1)], ...] = ()

    def decoder(self, picture: tuple[int, int], min_score: float) -> Decoder:
        grid = yolo_grid(self.strides, picture) if self.strides else None
        in_pixels = self.unit == "pixels" or grid is not None
        unit = np.array([*picture, *picture] if in_pixels else [1, 1, 1, 1], np.float32)
        first = 4 + self.objectness  # the first class

        def decode(outputs: Tensors) -> Found:
            table = self._table(outputs, first, -1 if grid is None else len(grid))
            # A class is no likelier than 1, so the objectness alone must reach the score.
            hopeful = table.array[:, 4] if self.objectness else table.array[:, 4:]
            above = may_reach(hopeful, table.scale, table.zero_point, min_score)
            hot = np.flatnonzero(above if self.objectness else above.any(axis=1))
            values = rows(table, hot)
            best, scores = best_class(values[:, first:])
            scores = np.clip(scores, 0, 1)
            if self.objectness:
                scores *= np.clip(values[:, 4], 0, 1)
            boxes = decode_yolo(values[:, :4], None if grid is None else grid[hot])
            return boxes / unit, best, scores

        return decode

    def _table(self, outputs: Tensors, first: int, count: int) -> Tensor:
        """The rows (n, 4 + classes) of the one picture, as stored; raises ModelError."""
        table = output(outputs, "rows")
        array = table.array.T if self.transposed else table.array
        if array.ndim != 2 or array.shape[1] <= first or count not in (-1, len(array)):
            wanted = ["n" if count == -1 else str(count), f"{first} + classes"]
            raise wrong_shape("rows", table, ", ".join(wanted[::-1] if self.transposed else wanted))
        return Tensor(array, table.scale, table.zero_point)
