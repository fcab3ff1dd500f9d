"""What two runs said on one port, held against each other message by message."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from stages.fused import FusedImage
from stages.kernels.agreement import label_agreement, match_boxes
from stages.kernels.compiled import as_input, locked
from stages.kernels.evaluation import labels_at
from stages.kernels.metrics import WIDTH, confusion
from stages.kernels.probability import read_out
from stages.kernels.sampling import sample_scores
from stages.taxonomy import load_taxonomy
from stages.types import ClassScores, Cloud, Detections, SemanticVoxels

#: Class scores and masks are compared at every so manieth pixel across and down.
STEP_PIXELS = 4
#: Boxes of one class that overlap by so much are the same thing.
MIN_IOU = 0.5


class Comparison(ABC):
    """Collects pairs of messages of one port; `page` is what came out, as plain values."""

    #: Only the last message counts, because each holds all that came before.
    last_only: ClassVar[bool] = False

    @staticmethod
    @abstractmethod
    def digest(payload: Any) -> Any:
        """What is kept of a payload until the other side has it too: small, and all that `add`
        needs."""

    @abstractmethod
    def add(self, a: Any, b: Any) -> None:
        """Take in the digests of two messages of one stamp."""

    @abstractmethod
    def page(self) -> dict[str, Any]:
        """The agreement; `classes` has one row for each class that occurs."""


class LabelComparison(Comparison):
    """Two label maps of the same places: (n,) labels and their confidence."""

    places: ClassVar[str] = "pixels"

    def __init__(self) -> None:
        self._matrix = np.zeros((WIDTH, WIDTH), dtype=np.int64)
        self._confidence_gap = 0.0
        self._names = load_taxonomy().names

    def add(self, a: Any, b: Any) -> None:
        (labels_a, confidence_a), (labels_b, confidence_b) = a, b
        self._matrix += confusion(labels_a, labels_b)
        self._confidence_gap += float(np.abs(confidence_a - confidence_b, dtype=np.float64).sum())

    def page(self) -> dict[str, Any]:
        found = label_agreement(self._matrix)
        return {
            "places": self.places,
            "count": found.places,
            "same_label": _number(found.same),
            "mean_iou": _number(found.mean_iou),
            "confidence_difference": _number(self._confidence_gap / max(found.places, 1)),
            "classes": [
                {
                    "class": name,
                    "share_a": _number(found.share[0, number]),
                    "share_b": _number(found.share[1, number]),
                    "iou": _number(found.iou[number]),
                }
                for number, name in enumerate(self._names)
                if found.share[:, number].any()
            ],
        }


class ScoreComparison(LabelComparison):
    """Class scores of images, at whatever stride and tiles either side has them."""

    @staticmethod
    def digest(payload: ClassScores) -> tuple[NDArray[np.uint8], NDArray[np.float16]]:
        width, height = payload.size
        first = STEP_PIXELS // 2
        v, u = np.mgrid[first:height:STEP_PIXELS, first:width:STEP_PIXELS].astype(np.float32)
        classes = len(load_taxonomy())
        rows, _ = sample_scores(
            locked(payload.grid),
            as_input(payload.rects),
            payload.scale,
            float(payload.zero_point),
            np.stack([u.ravel(), v.ravel()], axis=1),
            classes,
        )
        label, confidence, _ = read_out(as_input(rows), classes)
        return label, confidence.astype(np.float16)


class MaskComparison(LabelComparison):
    """Fused images."""

    @staticmethod
    def digest(payload: FusedImage) -> tuple[NDArray[np.uint8], NDArray[np.float16]]:
        every = slice(STEP_PIXELS // 2, None, STEP_PIXELS)
        confidence = payload.confidence[every, every].astype(np.float16)
        return payload.mask[every, every].ravel(), confidence.ravel()


class CloudComparison(LabelComparison):
    """Fused clouds of the same scans: labels where both have evidence, and who has it."""

    places = "points"

    def __init__(self) -> None:
        super().__init__()
        self._evidence = np.zeros(4, dtype=np.int64)  # neither, only b, only a, both

    @staticmethod
    def digest(payload: Cloud) -> tuple[NDArray[Any], ...]:
        label, confidence, _ = read_out(as_input(payload.log_scores), len(load_taxonomy()))
        return label, confidence.astype(np.float16), payload.evidence

    def add(self, a: Any, b: Any) -> None:
        evidence_a, evidence_b = a[2], b[2]
        if len(evidence_a) != len(evidence_b):
            return  # a filter before it let other points pass: there is nothing to pair
        self._evidence += np.bincount(2 * evidence_a + evidence_b, minlength=4)
        both = evidence_a & evidence_b
        super().add((a[0][both], a[1][both]), (b[0][both], b[1][both]))

    def page(self) -> dict[str, Any]:
        neither, only_b, only_a, both = (int(count) for count in self._evidence)
        seen = {"both": both, "only_a": only_a, "only_b": only_b, "neither": neither}
        return super().page() | {"evidence": seen}


class VoxelComparison(LabelComparison):
    """Maps: labels of the voxels that both hold, and who holds which."""

    places = "voxels"
    last_only = True

    def __init__(self) -> None:
        super().__init__()
        self._held = {"both": 0, "only_a": 0, "only_b": 0}

    @staticmethod
    def digest(payload: SemanticVoxels) -> tuple[NDArray[Any], ...]:
        label, confidence, _ = read_out(as_input(payload.log_scores), len(load_taxonomy()))
        return payload.indices, label, confidence

    def add(self, a: Any, b: Any) -> None:
        (voxels_a, labels_a, confidence_a), (voxels_b, labels_b, confidence_b) = a, b
        # 1 + row in b, 0 where b does not hold the voxel.
        row = labels_at(voxels_b, np.arange(1, len(voxels_b) + 1), voxels_a)
        both, in_b = row > 0, row[row > 0] - 1
        self._held["both"] += len(in_b)
        self._held["only_a"] += len(voxels_a) - len(in_b)
        self._held["only_b"] += len(voxels_b) - len(in_b)
        here = labels_a[both], confidence_a[both]
        super().add(here, (labels_b[in_b], confidence_b[in_b]))

    def page(self) -> dict[str, Any]:
        return super().page() | {"held": self._held}


class BoxComparison(Comparison):
    """Detections: which boxes have a counterpart, and how the scores of a pair differ (b - a)."""

    def __init__(self) -> None:
        self._names = load_taxonomy().names
        self._counts = np.zeros((2, WIDTH), dtype=np.int64)
        self._overlaps: list[list[float]] = [[] for _ in self._names]
        self._differences: list[list[float]] = [[] for _ in self._names]
        self._alone = np.zeros((2, WIDTH))  # the best score without a counterpart

    @staticmethod
    def digest(payload: Detections) -> tuple[NDArray[Any], ...]:
        return payload.boxes, payload.classes, payload.scores

    def add(self, a: Any, b: Any) -> None:
        pairs, overlaps = match_boxes(a[0], a[1], b[0], b[1], MIN_IOU)
        for (row_a, row_b), overlap in zip(pairs, overlaps, strict=True):
            label = a[1][row_a]
            self._overlaps[label].append(float(overlap))
            self._differences[label].append(float(b[2][row_b] - a[2][row_a]))
        for side, (_, classes, scores) in enumerate((a, b)):
            self._counts[side] += np.bincount(classes, minlength=WIDTH)
            alone = np.ones(len(classes), dtype=np.bool_)
            alone[pairs[:, side]] = False
            np.maximum.at(self._alone[side], classes[alone], scores[alone])

    def page(self) -> dict[str, Any]:
        every = [difference for some in self._differences for difference in some]
        return {
            "places": "boxes",
            "count_a": int(self._counts[0].sum()),
            "count_b": int(self._counts[1].sum()),
            "matched": len(every),
            "mean_iou": _mean([overlap for some in self._overlaps for overlap in some]),
            "score_difference": _mean(every),
            "largest_score_difference": _number(max(map(abs, every), default=math.nan)),
            "classes": [
                self._row(number, name)
                for number, name in enumerate(self._names)
                if self._counts[:, number].any()
            ],
        }

    def _row(self, number: int, name: str) -> dict[str, Any]:
        differences = self._differences[number]
        return {
            "class": name,
            "count_a": int(self._counts[0, number]),
            "count_b": int(self._counts[1, number]),
            "matched": len(differences),
            "iou": _mean(self._overlaps[number]),
            "score_difference": _mean(differences),
            "largest_score_difference": _number(max(map(abs, differences), default=math.nan)),
            "best_only_a": _number(self._alone[0, number] or math.nan),
            "best_only_b": _number(self._alone[1, number] or math.nan),
        }


#: How a payload is compared; others are named as not compared.
COMPARISONS: Mapping[type, Callable[[], Comparison]] = {
    ClassScores: ScoreComparison,
    Detections: BoxComparison,
    Cloud: CloudComparison,
    FusedImage: MaskComparison,
    SemanticVoxels: VoxelComparison,
}


def _number(value: float) -> float | None:
    """For JSON, which has no NaN."""
    return None if math.isnan(value) else round(float(value), 5)


def _mean(values: list[float]) -> float | None:
    return _number(sum(values) / len(values)) if values else None
