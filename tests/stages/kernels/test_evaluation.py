"""Means over classes and scans by hand, and ground truth against itself on a real scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stages.kernels.evaluation import (
    agreement,
    group_columns,
    labels_at,
    map_confusion,
    scan_confusion,
    scan_mean,
)
from stages.kernels.metrics import merge_groups
from stages.taxonomy import load_taxonomy

GROUPS = {
    "building": [1],
    "road": [3, 4],
    "vegetation": [7],
    "person": [5, 6],
    "bike": [11],
    "car": [13],
    "object": [14],
}


def test_rare_classes_stay_out_of_the_mean() -> None:
    truth = np.array([3] * 50 + [1] * 49 + [5] + [0] * 900)
    predicted = truth.copy()
    predicted[:10], predicted[99] = 1, 3
    matrix = scan_confusion(truth, predicted)
    found = agreement(matrix, min_points=2)
    assert found.iou[3] == pytest.approx(40 / 51)
    assert found.iou[1] == pytest.approx(49 / 59)
    assert found.iou[5] == 0
    assert found.mean == pytest.approx((40 / 51 + 49 / 59) / 2)
    assert found.points.sum() == 100, "the unlabeled do not count"
    by_share = agreement(matrix, min_points=0.011)
    assert by_share.mean == found.mean
    assert agreement(matrix).counted[5], "1 % of the points is enough by default"
    assert np.isnan(agreement(np.zeros((16, 16), np.int64)).mean)


def test_the_mean_over_scans_is_not_the_iou_of_all() -> None:
    good = scan_confusion(np.full(10, 3), np.full(10, 3))
    bad = scan_confusion(np.full(90, 3), np.array([3] * 45 + [1] * 45))
    assert agreement(good + bad).iou[3] == pytest.approx(55 / 100)
    assert scan_mean([good, bad]).iou[3] == pytest.approx((1.0 + 0.5) / 2)
    assert scan_mean([good, bad]).mean == pytest.approx(0.75)
    assert np.isnan(scan_mean([]).mean)


def test_in_the_camera_s_view_the_rest_does_not_count_and_outside_silence_is_a_miss() -> None:
    truth, predicted = np.array([3, 3, 3, 5]), np.array([3, 3, 3, 3])
    visible = np.array([True, True, False, False])
    assert scan_confusion(truth, predicted, visible=visible).sum() == 2
    said = np.array([True, False, False, True])
    matrix = scan_confusion(truth, predicted, said=said)
    assert matrix[3, 3] == 1
    assert matrix[3, 0] == 2
    assert agreement(matrix).iou[3] == pytest.approx(1 / 4)
    assert agreement(scan_confusion(truth, predicted, visible=said, said=said)).iou[3] == 0.5


def test_groups_are_the_columns_of_a_table() -> None:
    columns = group_columns(GROUPS)
    assert columns[[1, 3, 4, 5, 6, 14]].tolist() == [1, 2, 2, 4, 4, 7]
    assert columns[[0, 2, 15]].tolist() == [0, 0, 0]
    truth, predicted = np.array([3, 4, 6, 2]), np.array([4, 3, 5, 2])
    found = agreement(merge_groups(scan_confusion(truth, predicted), columns))
    assert found.iou[[2, 4]].tolist() == [1.0, 1.0]
    assert found.mean == 1.0
    with pytest.raises(ValueError, match="group 'b': id 3 stands in two groups"):
        group_columns({"a": [3], "b": [3]})
    with pytest.raises(ValueError, match=r"group 'a': id 16; classes are 1\.\.15"):
        group_columns({"a": [16]})


def test_a_map_is_compared_where_both_maps_are() -> None:
    truth_voxels = np.array([[0, 0, 0], [1, 0, 0], [-2, 5, 7]], np.int32)
    truth = np.array([3, 5, 7], np.uint8)
    voxels = np.array([[-2, 5, 7], [9, 9, 9], [0, 0, 0]], np.int32)
    labels = np.array([7, 1, 13], np.uint8)
    assert labels_at(truth_voxels, truth, voxels).tolist() == [7, 0, 3]
    both = map_confusion(truth_voxels, truth, voxels, labels)
    assert (both[7, 7], both[3, 13], both[5].sum()) == (1, 1, 0)
    every = map_confusion(truth_voxels, truth, voxels, labels, missing_counts=True)
    assert (every[7, 7], every[3, 13], every[5, 0]) == (1, 1, 1)
    nowhere = np.zeros((0, 3), np.int32)
    assert labels_at(nowhere, np.zeros(0, np.uint8), voxels).tolist() == [0, 0, 0]
    assert labels_at(truth_voxels, truth, nowhere).tolist() == []


def test_semantickitti_s_ground_truth_agrees_with_itself(shared: Path) -> None:
    folder = shared / "data" / "semantickitti_00" / "labels"
    total = np.zeros((16, 16), np.int64)
    for file in sorted(folder.glob("*.label")):
        raw = np.fromfile(file, np.uint32) & 0xFFFF
        truth = np.maximum(load_taxonomy().translate("semantickitti", raw), 0)
        total += scan_confusion(truth, truth)
    found = agreement(total)
    present = found.points > 0
    assert present.sum() >= 8
    assert (found.iou[present] == 1.0).all()
    assert found.mean == 1.0
    grouped = agreement(merge_groups(total, group_columns(GROUPS)))
    assert grouped.mean == 1.0
