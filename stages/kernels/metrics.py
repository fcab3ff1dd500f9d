"""Agreement of labels: the confusion matrix and intersection over union (eq 19)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

WIDTH = 16  #: class ids lie in 0..15


def confusion(
    truth: NDArray[np.integer[Any]], predicted: NDArray[np.integer[Any]]
) -> NDArray[np.int64]:
    """(16, 16) counts, rows by truth and columns by prediction; they add up over scans.

    Raises ValueError for an id outside 0..15.
    """
    truth, predicted = np.ravel(truth), np.ravel(predicted)
    for name, ids in (("truth", truth), ("predicted", predicted)):
        if ids.size and not 0 <= ids.min() <= ids.max() < WIDTH:
            raise ValueError(f"{name} holds ids {ids.min()}..{ids.max()}; they must lie in 0..15")
    pairs = truth.astype(np.int64) * WIDTH + predicted
    return np.bincount(pairs, minlength=WIDTH * WIDTH).reshape(WIDTH, WIDTH).astype(np.int64)


def merge_groups(matrix: NDArray[np.int64], groups: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """The confusion matrix with class i counted as `groups[i]` (16,)."""
    merged = np.zeros_like(matrix)
    np.add.at(merged, (groups[:, None], groups[None, :]), matrix)
    return merged


def intersection_over_union(
    matrix: NDArray[np.int64], ignore: tuple[int, ...] = (0,)
) -> NDArray[np.float64]:
    """(16,) TP / (TP + FP + FN) per class (eq 19), NaN where a class neither is nor was predicted.

    Points whose truth is in `ignore` do not count at all.
    """
    counted = matrix.copy()
    counted[list(ignore)] = 0
    hits = np.diag(counted).astype(np.float64)
    union = counted.sum(axis=0) + counted.sum(axis=1) - hits
    return np.asarray(np.divide(hits, union, out=np.full(WIDTH, np.nan), where=union > 0))
