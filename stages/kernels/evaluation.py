"""Evaluation over a data set (eq 19): means over classes, groups of classes, and maps against maps.

On top of `metrics`, whose confusion matrices (16, 16), rows by truth and columns by prediction, are
the only state; id 0 is unlabeled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.metrics import WIDTH, confusion, intersection_over_union

#: A class counts in the mean from this part of the labeled points on.
MIN_SHARE = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """IoU by class and its mean."""

    iou: NDArray[np.float64]  #: (k,) NaN where a class neither is nor was predicted
    points: NDArray[np.int64]  #: (k,) points whose truth is the class
    counted: NDArray[np.bool_]  #: (k,) occurs often enough to be in the mean
    mean: float  #: NaN where no class counts


def group_columns(groups: Mapping[str, Sequence[int]]) -> NDArray[np.int64]:
    """(16,) the column of each class id, 0 for those in no group; group i of the mapping is i + 1.

    Groups are the columns of a table, e.g. {"road": [3, 4], "person": [5, 6]}. Raises ValueError
    for an id in two groups or out of 1..15.
    """
    columns = np.zeros(WIDTH, dtype=np.int64)
    for number, (name, ids) in enumerate(groups.items(), start=1):
        for class_id in ids:
            if not 0 < class_id < WIDTH:
                raise ValueError(f"group '{name}': id {class_id}; classes are 1..{WIDTH - 1}")
            if columns[class_id]:
                raise ValueError(f"group '{name}': id {class_id} stands in two groups; keep one")
            columns[class_id] = number
    return columns


def scan_confusion(
    truth: NDArray[np.integer[Any]],
    predicted: NDArray[np.integer[Any]],
    *,
    visible: NDArray[np.bool_] | None = None,
    said: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    """The confusion (16, 16) of one scan, truth and prediction (n,).

    `visible` (n,) leaves out the points outside it (the camera's field of view; None: all). `said`
    (n,): where nothing was said the prediction is 0, a miss and never a hit.
    """
    shown = predicted if said is None else np.where(said, predicted, 0)
    if visible is None:
        return confusion(truth, shown)
    return confusion(truth[visible], shown[visible])


def agreement(matrix: NDArray[np.int64], *, min_points: float = MIN_SHARE) -> Agreement:
    """IoU of every class 0..15 of an accumulated confusion, unlabeled truth left out.

    `min_points` below 1 is a part of the labeled points, else a number of points: classes with
    fewer do not enter the mean.
    """
    points = matrix.sum(axis=1)
    points[0] = 0
    least = min_points * points.sum() if min_points < 1 else min_points
    counted = (points > 0) & (points >= least)
    iou = intersection_over_union(matrix)
    return Agreement(iou, points, counted, _mean(iou[counted]))


def scan_mean(matrices: Sequence[NDArray[np.int64]], *, min_points: float = MIN_SHARE) -> Agreement:
    """The other reading of "average over the data set": IoU per scan, then the mean over the scans
    in which the class is or was predicted. Which classes count is decided over all scans.
    """
    total = agreement(sum(matrices, np.zeros((WIDTH, WIDTH), np.int64)), min_points=min_points)
    each = np.array([intersection_over_union(matrix) for matrix in matrices]).reshape(-1, WIDTH)
    present = ~np.isnan(each)
    counts = present.sum(axis=0)
    sums = np.where(present, each, 0.0).sum(axis=0)
    iou = np.divide(sums, counts, out=np.full(WIDTH, np.nan), where=counts > 0)
    return Agreement(iou, total.points, total.counted, _mean(iou[total.counted]))


def labels_at(
    voxels: NDArray[np.integer[Any]],
    labels: NDArray[np.integer[Any]],
    wanted: NDArray[np.integer[Any]],
) -> NDArray[np.int64]:
    """The labels (m,) that a map gives to voxels `wanted` (m, 3): 0 where it has none.

    The map's `voxels` (n, 3) indices and `labels` (n,). For map against map, both at one voxel
    size, or points against a map by floor(position / voxel size).
    """
    everything = np.concatenate([voxels, wanted]).astype(np.int64)
    _, number = np.unique(everything, axis=0, return_inverse=True)
    number = number.reshape(-1)
    by_number = np.zeros(int(number.max(initial=-1)) + 1, dtype=np.int64)
    by_number[number[: len(voxels)]] = labels
    return by_number[number[len(voxels) :]]


def map_confusion(
    truth_voxels: NDArray[np.integer[Any]],
    truth: NDArray[np.integer[Any]],
    voxels: NDArray[np.integer[Any]],
    labels: NDArray[np.integer[Any]],
    *,
    missing_counts: bool = False,
) -> NDArray[np.int64]:
    """The confusion of a map (n, 3), (n,) against an annotated one (m, 3), (m,).

    Over the annotated voxels that the map holds; with `missing_counts` over all, and what the map
    lacks is a miss.
    """
    if missing_counts:
        return confusion(truth, labels_at(voxels, labels, truth_voxels))
    return confusion(labels_at(truth_voxels, truth, voxels), labels)


def _mean(values: NDArray[np.float64]) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
