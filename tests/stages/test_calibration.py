"""The calibration block: every spelling of a pose, and every mistake with its key."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pipeline.errors import DataError
from stages.types import Calibration

QUARTER_LEFT = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
CAMERA = {"size": [848, 480], "fx": 420.0, "fy": 421, "cx": 424.5, "cy": 240.0}


def parse_pose(pose: Any) -> np.ndarray:
    return Calibration.parse({"lidar": {"base_from_sensor": pose}}).sensor("lidar").base_from_sensor


@pytest.mark.parametrize(
    "pose",
    [
        [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]],
        [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]],
        {"translation": [1, 2, 3], "quaternion": [0, 0, 0.70710678, 0.70710678]},
        {"translation": [1, 2, 3], "rotation_rpy_deg": [0, 0, 90]},
    ],
)
def test_a_pose_is_the_same_in_every_spelling(pose: Any) -> None:
    found = parse_pose(pose)
    np.testing.assert_allclose(found[:3, :3], QUARTER_LEFT, atol=1e-7)
    assert found[:, 3].tolist() == [1, 2, 3, 1]


def test_roll_comes_first_then_pitch_then_yaw_about_fixed_axes() -> None:
    found = parse_pose({"translation": [0, 0, 0], "rotation_rpy_deg": [90, 0, 90]})
    np.testing.assert_allclose(found[:3, :3] @ (0, 1, 0), (0, 0, 1), atol=1e-12)  # up after roll
    np.testing.assert_allclose(found[:3, :3] @ (1, 0, 0), (0, 1, 0), atol=1e-12)  # left after yaw


def test_a_camera_is_read_and_distortion_defaults_to_none() -> None:
    block = {"rgb": {"base_from_sensor": np.eye(4).tolist(), "camera": CAMERA}}
    calibration = Calibration.parse(block)
    camera = calibration.camera("rgb")
    assert camera.size == (848, 480)
    assert camera.intrinsics().tolist() == [420, 421, 424.5, 240, 0, 0, 0, 0, 0]
    assert calibration.cameras() == ("rgb",)


def skewed() -> list[list[float]]:
    matrix = np.eye(4)
    matrix[0, 1] = 0.01
    return matrix.tolist()


def camera(**changes: Any) -> dict[str, Any]:
    return {"base_from_sensor": np.eye(4).tolist(), "camera": {**CAMERA, **changes}}


MIRRORED = np.diag([1.0, 1.0, -1.0, 1.0]).tolist()
SHIFT = {"translation": [0, 0, 0]}


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        (None, "s: give the keys base_from_sensor, camera"),
        ({}, "s: base_from_sensor is missing"),
        ({"base_from_sensr": []}, "unknown key 'base_from_sensr'; did you mean 'base_from_sensor'"),
        ({"base_from_sensor": [[1, 2], [3, 4]]}, "s.base_from_sensor: give 3 or 4 rows of 4"),
        ({"base_from_sensor": "front"}, "s.base_from_sensor: give 3 or 4 rows of 4"),
        ({"base_from_sensor": skewed()}, r"not orthonormal \(off by 0.01\)"),
        ({"base_from_sensor": MIRRORED}, "the rotation mirrors"),
        ({"base_from_sensor": np.ones((4, 4)).tolist()}, "the last row"),
        ({"base_from_sensor": SHIFT}, "give either quaternion or rotation_rpy_deg"),
        (
            {"base_from_sensor": {**SHIFT, "quaternion": [0, 0, 0, 2]}},
            "s.base_from_sensor.quaternion: length 2, not 1",
        ),
        (
            {"base_from_sensor": {**SHIFT, "quaternion": [0, 0, 1]}},
            "s.base_from_sensor.quaternion: give 4 finite numbers",
        ),
        ({"base_from_sensor": {"quaternion": [0, 0, 0, 1]}}, "translation is missing"),
        (camera(fx=None), "s.camera.fx: give 1 finite number"),
        (camera(fx=-3), "s.camera: fx and fy are focal lengths"),
        (camera(size=[0, 480]), "s.camera.size: 0 x 480 is no image"),
        (camera(cx=float("nan")), "s.camera.cx: give 1 finite number"),
        (camera(distortion=[0.1]), "s.camera.distortion: give 5 finite numbers"),
        (camera(focal=3), "s.camera: unknown key 'focal'"),
        ({"base_from_sensor": np.eye(4).tolist(), "camera": {"size": [2, 2]}}, "s.camera: fx is m"),
    ],
)
def test_a_mistake_names_its_key_and_the_way_out(sensor: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Calibration.parse({"s": sensor})


def test_an_unknown_sensor_and_a_sensor_without_a_camera_are_said() -> None:
    calibration = Calibration.parse({"lidar": {"base_from_sensor": np.eye(4).tolist()}})
    with pytest.raises(DataError, match=r"no calibration for sensor 'rgb' \(known: lidar\)"):
        calibration.sensor("rgb")
    with pytest.raises(DataError, match="calibration of 'lidar' has no camera"):
        calibration.camera("lidar")
