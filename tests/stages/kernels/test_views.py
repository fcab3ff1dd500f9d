"""Scans of an aggregated cloud from above."""

from __future__ import annotations

import numpy as np

from stages.kernels.views import seen_in_window, view

SIZE, FIELD = (64, 512), (-np.pi / 4, np.pi / 4)
DYNAMIC = np.zeros(16, np.bool_)
DYNAMIC[13] = True


def test_what_stands_still_is_there_in_all_scans_and_what_moves_in_those_near() -> None:
    classes = np.array([1, 13, 13, 13], np.uint8)
    scans = np.array([0, 8, 9, 12], np.int32)
    for window, expected in ((0, [1, 0, 0, 0]), (2, [1, 1, 1, 1]), (1, [1, 0, 1, 0])):
        seen = seen_in_window(classes, scans, DYNAMIC, 10 if window != 0 else 11, window)
        assert seen.tolist() == [bool(one) for one in expected]


def test_of_each_cell_the_nearest_point_is_kept_and_none_beyond_the_range() -> None:
    points = np.array([[10, 0, 0], [20, 0, 0], [0, 60, 0], [5, 0, -4.9]], np.float32)
    nearest, local = view(points, np.zeros(3), SIZE, FIELD, max_range_m=50.0)
    assert sorted(nearest[nearest >= 0]) == [0, 3]
    np.testing.assert_array_equal(local, points)


def test_the_same_place_is_seen_from_the_viewpoint() -> None:
    points = np.array([[10, 0, 0]], np.float32)
    nearest, local = view(points, np.array([10.0, -20.0, 5.0]), SIZE, FIELD)
    np.testing.assert_allclose(local, [[0, 20, -5]])
    (row,), (column,) = np.nonzero(nearest >= 0)
    assert column == 512 // 4  # straight to the left
    assert row == int((np.pi / 4 + np.arcsin(5 / np.hypot(20, 5))) / (np.pi / 2) * 64)


def wall_before_wall() -> np.ndarray:
    """A sparse wall 3 m ahead, a dense one 20 m behind it: seen through its gaps."""
    y, z = np.meshgrid(np.arange(-1, 1, 0.12), np.arange(-1, 1, 0.12))
    near = np.column_stack([np.full(y.size, 3.0), y.ravel(), z.ravel()])
    y, z = np.meshgrid(np.arange(-5, 5, 0.1), np.arange(-5, 5, 0.1))
    far = np.column_stack([np.full(y.size, 23.0), y.ravel(), z.ravel()])
    return np.concatenate([near, far]).astype(np.float32)


def test_points_with_a_width_hide_what_lies_behind_the_gaps_between_them() -> None:
    points = wall_before_wall()
    size = (128, 1024)
    through, _ = view(points, np.zeros(3), size, FIELD)
    whole, _ = view(points, np.zeros(3), size, FIELD, point_m=0.3)
    behind = np.zeros(size, np.bool_)
    row, column = np.nonzero(through >= 0)
    far = points[through[row, column], 0] > 20
    behind[row[far], column[far]] = True
    middle = np.s_[52:76, 490:534]  # well inside the near wall's outline
    assert behind[middle].mean() > 0.3
    seen = whole[middle]
    assert (points[seen[seen >= 0], 0] < 20).all()
    # The near wall itself loses nothing, and what it does not cover stays.
    assert set(through[through >= 0][points[through[through >= 0], 0] < 20]) <= set(whole.ravel())
    assert (whole[:, 600:] == through[:, 600:]).all()
