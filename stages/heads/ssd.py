"""Head of single-shot detectors cut before their post-processing: anchors, regressions, scores.

MobileDet, SSDLite and their like. Compared with the same network with its post-processing in the
file, everything up to here may run on the Edge TPU, and weak anchors are never decoded.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pipeline.model import Tensor, Tensors
from stages.heads.head import Decoder, Head, Settings, output, rows, wrong_shape
from stages.kernels.anchors import decode_anchored, multiscale_anchors, ssd_anchors
from stages.kernels.boxes import Found
from stages.kernels.scores import best_class, logit, may_reach, sigmoid, softmax

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]


class SsdAnchors(Settings):
    """`ssd_anchor_generator` of a TensorFlow Object Detection configuration."""

    kind: Literal["ssd"]
    maps: tuple[Count | tuple[Count, Count], ...] = Field(min_length=1)  #: cells: n or [rows, cols]
    scales: tuple[Positive, ...]  #: one per map
    ratios: tuple[Positive, ...] = (1.0, 2.0, 0.5, 3.0, 1 / 3)
    reduce_lowest: bool = True

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len(self.scales) != len(self.maps):
            raise ValueError(f"{len(self.maps)} maps need as many scales, not {len(self.scales)}")
        return self

    def of(self, picture: tuple[int, int]) -> NDArray[np.float32]:
        maps = [(cells, cells) if isinstance(cells, int) else cells for cells in self.maps]
        return ssd_anchors(
            maps, self.scales, self.ratios, picture, reduce_lowest=self.reduce_lowest
        )


class MultiscaleAnchors(Settings):
    """`multiscale_anchor_generator`, of networks with a feature pyramid."""

    kind: Literal["multiscale"]
    levels: tuple[Count, Count]  #: first and last: strides 2^level, pixels
    base: Positive = 4.0  #: side of the smallest form, in strides
    ratios: tuple[Positive, ...] = (1.0, 2.0, 0.5)
    per_octave: Count = 2

    @model_validator(mode="after")
    def _check(self) -> Self:
        first, last = self.levels
        if not first <= last <= 12:
            raise ValueError(f"levels must rise and end at 12, not go from {first} to {last}")
        return self

    def of(self, picture: tuple[int, int]) -> NDArray[np.float32]:
        return multiscale_anchors(self.levels, self.base, self.ratios, self.per_octave, picture)


class Ssd(Head):
    """Outputs `boxes` (1, n, 4) ty tx th tw and `scores` (1, n, classes); one result per anchor.

    `scores` of the settings says what the network gives: logits for "sigmoid" or "softmax", or each
    "probability" itself. With `background`, class 0 is "nothing".
    """

    kind: Literal["ssd"]
    anchors: SsdAnchors | MultiscaleAnchors = Field(discriminator="kind")
    coder: tuple[Positive, Positive, Positive, Positive] = (10.0, 10.0, 5.0, 5.0)
    scores: Literal["sigmoid", "softmax", "probability"] = "sigmoid"
    background: bool = True

    def decoder(self, picture: tuple[int, int], min_score: float) -> Decoder:
        anchors = self.anchors.of(picture)
        first = int(self.background)

        def decode(outputs: Tensors) -> Found:
            boxes = output(outputs, "boxes", len(anchors), 4)
            scores = output(outputs, "scores", len(anchors), -1)
            if scores.array.shape[1] <= first:
                raise wrong_shape("scores", scores, f"{len(anchors)}, {first} + classes")
            hot = self._candidates(scores, min_score)
            values = rows(scores, hot)
            if self.scores == "softmax":
                values = softmax(values)
            best, score = best_class(values[:, first:])
            if self.scores == "sigmoid":  # it keeps the order, so the best alone needs it
                score = sigmoid(score)
            return decode_anchored(rows(boxes, hot), anchors[hot], self.coder), best + first, score

        return decode

    def _candidates(self, scores: Tensor, min_score: float) -> NDArray[np.intp]:
        """The anchors with a class that may reach the score."""
        array = scores.array
        if self.scores == "softmax":
            # p >= s needs a lead of logit(s) over any other class, and the differences of stored
            # numbers need no zero point.
            rival = array[:, 0] if self.background else array.min(axis=1)
            wide = np.int32 if array.dtype.kind in "iu" else array.dtype
            with np.errstate(invalid="ignore", over="ignore"):
                lead = np.subtract(array, rival[:, None], dtype=wide)
            above = may_reach(lead, scores.scale, 0, logit(min_score))
        else:
            least = logit(min_score) if self.scores == "sigmoid" else min_score
            above = may_reach(array, scores.scale, scores.zero_point, least)
        if self.background:
            above[:, 0] = False
        # Most anchors are cold and rows are short: far quicker than any(axis=1).
        anchor = np.flatnonzero(above) // above.shape[1]
        return np.asarray(anchor[np.diff(anchor, prepend=-1) > 0])
