"""The street that the kernels are measured on is what it says."""

from __future__ import annotations

import numpy as np

from tools.bench.kernel_scene import (
    CALIBRATION,
    HEIGHT,
    PERSON,
    ROAD,
    VEHICLE,
    WIDTH,
    cast,
    frames,
)


def test_a_ray_ends_at_the_first_box_or_on_the_road() -> None:
    boxes = np.array([[5, -1, 0, 6, 1, 3], [2, -1, 0, 3, 1, 1]], np.float32)
    labels = np.array([PERSON, VEHICLE], np.uint8)
    rays = np.array([[1, 0, 0], [1, 0, -0.5], [0, 0, -2], [-1, 0, 0], [0, 0, 1], [1, 0, -0.75]])
    reach, hit = cast(rays, np.array([0.0, 0.0, 2.0]), boxes, labels)
    np.testing.assert_allclose(reach, [5, 2, 1, 0, 0, 2], atol=1e-9)
    assert hit.tolist() == [PERSON, VEHICLE, ROAD, 0, 0, VEHICLE]


def test_depth_and_boxes_show_what_the_labels_say() -> None:
    (frame,) = frames(1)
    assert frame.points.shape == (131_072, 3)
    assert frame.depth.shape == frame.labels.shape == (HEIGHT, WIDTH)
    assert {ROAD, PERSON, VEHICLE} <= set(np.unique(frame.labels))
    below = np.linalg.inv(CALIBRATION.sensor("rgb").base_from_sensor)[1, 3] + 2.5
    row, ground = HEIGHT - 1, frame.depth[HEIGHT - 1][frame.labels[HEIGHT - 1] == ROAD]
    camera = CALIBRATION.camera("rgb")
    expected = below / ((row - camera.cy) / camera.fy)
    np.testing.assert_allclose(ground / 1000, expected, atol=0.01)
    for x0, y0, x1, y1 in np.rint(frame.boxes["rgb"]).astype(int):
        inside = frame.labels[y0 : y1 + 1, x0 : x1 + 1]
        assert np.isin(inside, (PERSON, VEHICLE)).mean() > 0.3
