"""Head of OpenVINO's detectors, whose last layer is DetectionOutput: rows of finished boxes."""

from __future__ import annotations

from typing import Literal

import numpy as np

from pipeline.model import Tensors
from stages.heads.head import Decoder, Head, output
from stages.kernels.boxes import Found, class_ids


class DetectionOutput(Head):
    """Output `detections` (1, 1, n, 7): image, class, score, x0, y0, x1, y1; image -1 ends it."""

    kind: Literal["detection_output"]

    def decoder(self, picture: tuple[int, int], min_score: float) -> Decoder:
        def decode(outputs: Tensors) -> Found:
            table = output(outputs, "detections", -1, 7).values()
            ends = np.flatnonzero(table[:, 0] < 0)
            table = table[: ends[0]] if len(ends) else table
            return table[:, 3:7], class_ids(table[:, 1]), table[:, 2]

        return decode
