"""Confusion and IoU, counted by hand."""

from __future__ import annotations

import numpy as np
import pytest

from stages.kernels.metrics import confusion, intersection_over_union, merge_groups


def test_iou_is_hits_over_hits_and_errors() -> None:
    truth = np.array([3, 3, 3, 5, 5, 0, 0])
    predicted = np.array([3, 3, 5, 5, 3, 3, 5])
    matrix = confusion(truth, predicted)
    assert matrix[3].sum() == 3
    assert matrix.sum() == 7
    iou = intersection_over_union(matrix)
    assert iou[3] == pytest.approx(2 / 4)  # TP 2, FN 1, FP 1; the unlabeled do not count
    assert iou[5] == pytest.approx(1 / 3)
    assert np.isnan(iou[[0, 1, 15]]).all()


def test_confusions_of_scans_add_up() -> None:
    rng = np.random.default_rng(0)
    truth, predicted = rng.integers(0, 16, (2, 1_000)).astype(np.uint8)
    parts = confusion(truth[:300], predicted[:300]) + confusion(truth[300:], predicted[300:])
    np.testing.assert_array_equal(parts, confusion(truth, predicted))


def test_merged_groups_confuse_no_more() -> None:
    groups = np.arange(16)
    groups[4] = 3
    matrix = merge_groups(confusion(np.array([3, 4, 5]), np.array([4, 3, 3])), groups)
    assert matrix[3, 3] == 2
    assert matrix[5, 3] == 1
    assert matrix.sum() == 3


def test_an_id_outside_0_to_15_is_refused() -> None:
    with pytest.raises(ValueError, match=r"predicted holds ids 1\.\.16"):
        confusion(np.array([1, 2]), np.array([1, 16]))
