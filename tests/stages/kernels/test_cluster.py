"""Points of a box, and those in front."""

from __future__ import annotations

import numpy as np

from stages.kernels.cluster import foreground, points_in_box


def test_points_in_a_box_include_its_edges() -> None:
    pixel = np.array([[0, 0], [10, 5], [20, 10], [20.1, 10], [15, 4.9]], np.float32)
    assert points_in_box(pixel, np.array([10, 5, 20, 10], np.float32)).tolist() == [1, 2]


def test_the_foreground_lies_around_the_25_percent_quantile_not_around_the_wall_behind() -> None:
    person, wall, stray = [8.0, 8.1, 8.2, 8.3], [15.0] * 6, [3.0]
    distance = np.array(wall + person + stray, np.float32)
    assert foreground(distance, 1.0).tolist() == [False] * 6 + [True] * 4 + [False]


def test_an_empty_box_has_no_foreground() -> None:
    assert foreground(np.zeros(0, np.float32), 1.0).tolist() == []
