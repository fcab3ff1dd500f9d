"""Labels of voxels, looked up for points."""

from __future__ import annotations

import numpy as np

from stages.kernels.propagation import confident_labels, looked_up, slots_of_points
from stages.kernels.voxels import index_keys, pack, unpack


def row(label: int, probability: float, classes: int = 15) -> np.ndarray:
    rest = (1 - probability) / (classes - 1)
    scores = np.full(16, np.log(rest), np.float32)
    scores[label] = np.log(probability)
    scores[classes:] = -1e4
    return scores


def test_labels_below_the_confidence_are_left_out() -> None:
    rows = np.stack([row(3, 0.81), row(3, 0.79), row(8, 0.99), row(1, 0.99)])
    assert confident_labels(rows, 15, 0.80).tolist() == [3, 0, 8, 1]
    assert confident_labels(rows, 15, 0.0, never=[8]).tolist() == [3, 3, 0, 1]


def test_keys_are_packed_as_they_are_unpacked() -> None:
    indices = np.array([[0, 0, 0], [-1, 5, -7], [1 << 19, -(1 << 19), 3]], np.int32)
    np.testing.assert_array_equal(unpack(pack(indices)), indices)


def test_a_point_gets_the_label_of_its_voxel_under_its_pose() -> None:
    keys = pack(np.array([[4, 0, 0], [-1, 0, 2]], np.int32))
    table = np.zeros(16, np.int32)
    index_keys(keys, 2, table)
    pose = np.eye(4)
    pose[:3, 3] = [1.0, 0, 0]  # the sensor is a meter ahead of the map's origin
    points = np.array([[0.1, 0.2, 0.1], [-1.1, 0.1, 0.6], [5, 5, 5], [0.1, 0.2, 0.1]], np.float32)
    wanted = np.array([True, True, True, False])
    slots = slots_of_points(points, wanted, pose, 0.25, table, keys)
    assert slots.tolist() == [0, 1, -1, -1]
    assert looked_up(np.array([3, 13], np.uint8), slots).tolist() == [3, 13, 0, 0]
    assert looked_up(np.zeros(0, np.uint8), slots).tolist() == [0, 0, 0, 0]
