"""Head of TensorFlow Lite detectors that end in TFLite_Detection_PostProcess: finished boxes."""

from __future__ import annotations

from typing import Literal

from pipeline.model import Tensors
from stages.heads.head import Decoder, Head, output
from stages.kernels.boxes import Found, class_ids


class SsdPostprocessed(Head):
    """Outputs `boxes` (1, n, 4) y0 x0 y1 x1 in parts, `classes` and `scores` (1, n), `count` (1,).

    Classes are counted without the network's class for "nothing".
    """

    kind: Literal["ssd_postprocessed"]

    def decoder(self, picture: tuple[int, int], min_score: float) -> Decoder:
        def decode(outputs: Tensors) -> Found:
            boxes = output(outputs, "boxes", -1, 4).values()
            classes = output(outputs, "classes", len(boxes)).values()
            scores = output(outputs, "scores", len(boxes)).values()
            count = float(output(outputs, "count", 1).values()[0])
            # Rows beyond the count hold whatever was there before.
            valid = slice(0, int(count) if 0 <= count <= len(boxes) else 0)
            return boxes[valid][:, [1, 0, 3, 2]], class_ids(classes[valid]), scores[valid]

        return decode
