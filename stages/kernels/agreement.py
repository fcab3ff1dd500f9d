"""How far two answers to one question agree, neither being the truth: labels, and boxes.

Unlike `evaluation`, which holds a prediction against the truth, everything here is symmetric: with
the two sides exchanged, the agreement is the same and the differences change their sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.kernels.metrics import intersection_over_union

#: A class counts in the mean where either side gives it to this part of all places.
MIN_SHARE = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class LabelAgreement:
    """Two label maps, from the counts of pairs of labels."""

    places: int  #: places labeled by both
    same: float  #: part of the places with the same label; NaN without places
    iou: NDArray[np.float64]  #: (16,) per class; NaN where neither side has it
    share: NDArray[np.float64]  #: (2, 16) part of the places that each side gives to each class
    mean_iou: float  #: over the classes with MIN_SHARE on either side; NaN where there is none


def label_agreement(matrix: NDArray[np.int64]) -> LabelAgreement:
    """The agreement of a matrix (16, 16) of `metrics.confusion`, rows one side, columns the other.

    Every class counts, background too: "nothing here" is an answer that two networks may share.
    """
    places = int(matrix.sum())
    iou = intersection_over_union(matrix, ignore=())
    share = np.stack([matrix.sum(axis=1), matrix.sum(axis=0)]) / max(places, 1)
    counted = share.max(axis=0) >= MIN_SHARE
    return LabelAgreement(
        places,
        float(np.trace(matrix) / places) if places else float("nan"),
        iou,
        share,
        float(iou[counted].mean()) if counted.any() else float("nan"),
    )


def box_overlap(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float64]:
    """(n, m) intersection over union of boxes (n, 4) and (m, 4) x0 y0 x1 y1; 0 for an empty box."""
    low = np.maximum(a[:, None, :2], b[None, :, :2]).astype(np.float64)
    high = np.minimum(a[:, None, 2:], b[None, :, 2:]).astype(np.float64)
    shared = np.prod(np.clip(high - low, 0.0, None), axis=2)
    area_a, area_b = (np.prod(np.clip(c[:, 2:] - c[:, :2], 0, None), axis=1) for c in (a, b))
    union = area_a[:, None].astype(np.float64) + area_b[None, :] - shared
    return np.asarray(np.divide(shared, union, out=np.zeros_like(shared), where=union > 0))


def match_boxes(
    boxes_a: NDArray[np.float32],
    classes_a: NDArray[np.int64],
    boxes_b: NDArray[np.float32],
    classes_b: NDArray[np.int64],
    min_iou: float,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Pairs (k, 2) of boxes of one class that overlap by `min_iou` or more, and how much (k,).

    Each box is in one pair at most; the pair that overlaps most is taken first, equal ones in the
    order of `boxes_a`, then `boxes_b`.
    """
    overlap = box_overlap(boxes_a, boxes_b)
    overlap[classes_a[:, None] != classes_b[None, :]] = 0.0
    rows, columns = np.nonzero((overlap >= min_iou) & (overlap > 0))
    order = np.argsort(-overlap[rows, columns], kind="stable")
    free_a, free_b = np.ones(len(boxes_a), np.bool_), np.ones(len(boxes_b), np.bool_)
    pairs = []
    for row, column in zip(rows[order], columns[order], strict=True):
        if free_a[row] and free_b[column]:
            free_a[row] = free_b[column] = False
            pairs.append((row, column))
    matched = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return matched, overlap[matched[:, 0], matched[:, 1]]
