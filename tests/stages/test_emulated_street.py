from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from stages.emulated_street import (
    ALTITUDE_M,
    BOXES,
    END_M,
    lidar_rays,
    look_along,
    look_through,
    painted,
    painted_gray,
    read_classes,
)
from stages.frames import look, mounted
from stages.taxonomy import load_taxonomy
from stages.types import Calibration

TAXONOMY = load_taxonomy()
RIG = Path(__file__).parents[2] / "graphs" / "calibration" / "emulated_uav.yaml"


def rig() -> Calibration:
    return Calibration.parse(yaml.safe_load(RIG.read_text())["calibration"])


@pytest.mark.parametrize(
    ("ray", "name", "distance"),
    [
        ([0, 0, -1], "road", ALTITUDE_M),
        ([0, -1, 0], "building", 7.5),
        ([0, 0, 1], "sky", np.inf),
        ([1, 0, 0], "sky", np.inf),
        ([9.5, -2.5, 1 - ALTITUDE_M], "vehicle", 1.0),  # its rear
        ([19.75, 2.0, 2.6 - ALTITUDE_M], "vehicle", 1.0),  # another's roof
        ([16.0, 7.5, 1 - ALTITUDE_M], "barrier", 1.0),
    ],
)
def test_a_ray_meets_what_stands_first_in_its_way(
    ray: list[float], name: str, distance: float
) -> None:
    sight = look_along(np.array([ray], np.float32), np.eye(4))
    assert TAXONOMY.names[sight.label[0]] == name
    assert sight.distance[0] == pytest.approx(distance, rel=1e-5)


def test_the_street_looks_the_same_from_further_on() -> None:
    """Everything either has no end along x or keeps the vehicle's pace."""
    for name, low, high in BOXES:
        endless = (low[0], high[0]) == (-END_M, END_M)
        assert endless != bool(TAXONOMY.dynamic[TAXONOMY.id(name)])


@pytest.mark.parametrize("camera", ["front_upper", "front_lower", "thermal"])
def test_camera_and_lidar_see_one_street(camera: str) -> None:
    """Of the points in view, nearly all lie at the depth and in the class of their pixel; the rest
    is seen by one and hidden from the other."""
    calibration = rig()
    rays = lidar_rays(128, 1024)
    lidar = look_along(rays, calibration.sensor("lidar").base_from_sensor)
    near = np.where(lidar.distance < 40, lidar.distance, 0)[..., None]
    points = (near * rays).reshape(-1, 3)
    lens = calibration.camera(camera)
    sight = look_through(lens, calibration.sensor(camera).base_from_sensor)
    view = look(lens, points, points.any(axis=1), mounted(calibration, camera, "lidar"))
    assert len(view.index) > 4_000
    u, v = np.rint(view.pixel).astype(int).T
    camera_from_lidar = mounted(calibration, camera, "lidar")
    depth = points[view.index] @ camera_from_lidar[2, :3] + camera_from_lidar[2, 3]
    alike = np.abs(depth - sight.distance[v, u]) < 0.05 * depth
    assert alike.mean() > 0.97
    assert (lidar.label.ravel()[view.index] == sight.label[v, u])[alike].mean() > 0.98


def test_the_two_cameras_stand_one_above_the_other_and_overlap() -> None:
    calibration = rig()
    rays = lidar_rays(64, 512).reshape(-1, 3)
    seen = []
    for camera in ("front_upper", "front_lower"):
        chain = mounted(calibration, camera, "lidar")
        view = look(calibration.camera(camera), 10 * rays, np.ones(len(rays), bool), chain)
        seen.append(set(view.index.tolist()))
    upper, lower = seen
    assert 0.15 < len(upper & lower) / len(lower) < 0.35
    assert max(rays[list(lower - upper), 2]) < min(rays[list(upper - lower), 2]) + 0.5


def test_rays_of_a_lidar_are_those_of_eq_18() -> None:
    rays = lidar_rays(4, 8)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, rtol=1e-6)
    row = np.floor((1 - (np.arcsin(rays[..., 2]) + np.pi / 4) / (np.pi / 2)) * 4)
    column = np.floor(0.5 * (1 - np.arctan2(rays[..., 1], rays[..., 0]) / np.pi) * 8)
    np.testing.assert_array_equal(row, np.mgrid[:4, :8][0])
    np.testing.assert_array_equal(column, np.mgrid[:4, :8][1])


def test_paint_reads_as_what_was_painted() -> None:
    every = np.arange(len(TAXONOMY), dtype=np.uint8)
    np.testing.assert_array_equal(read_classes(painted(every)), every)
    np.testing.assert_array_equal(read_classes(painted_gray(every)[:, None]), every)
    warm = painted_gray(every)[TAXONOMY.dynamic]
    assert warm.min() > painted_gray(every)[~TAXONOMY.dynamic].max()


def test_other_paint_is_background() -> None:
    assert read_classes(np.array([[250, 250, 250]], np.uint8)).tolist() == [0]
    assert read_classes(np.array([[255]], np.uint8)).tolist() == [0]
