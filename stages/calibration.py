"""Reading one sensor of a ``calibration:`` block, with mistakes that name their key."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.geometry import rotation_from_quaternion
from stages.types import Camera, SensorCalibration

ORTHONORMAL = 1e-3  #: how far a rotation matrix may be from orthonormal: rounded files pass


def parse_sensor(name: str, block: Any) -> SensorCalibration:
    """A sensor of the block (see `Calibration.parse`); raises ValueError naming the key."""
    keys = _mapping(name, block, known=("base_from_sensor", "camera"))
    if "base_from_sensor" not in keys:
        raise ValueError(f"{name}: base_from_sensor is missing; give the sensor's pose in the base")
    pose = _pose(f"{name}.base_from_sensor", keys["base_from_sensor"])
    camera = keys.get("camera")
    return SensorCalibration(pose, None if camera is None else _camera(f"{name}.camera", camera))


def _pose(key: str, value: Any) -> NDArray[np.float64]:
    pose = np.eye(4)
    if isinstance(value, Mapping):
        parts = _mapping(key, value, known=("translation", "quaternion", "rotation_rpy_deg"))
        if ("quaternion" in parts) == ("rotation_rpy_deg" in parts):
            raise ValueError(f"{key}: give either quaternion or rotation_rpy_deg")
        if "translation" not in parts:
            raise ValueError(f"{key}: translation is missing; give [x, y, z] in meters")
        pose[:3, 3] = _numbers(f"{key}.translation", parts["translation"], 3)
        if "quaternion" in parts:
            quaternion = _numbers(f"{key}.quaternion", parts["quaternion"], 4)
            if abs(np.linalg.norm(quaternion) - 1.0) > 0.01:
                raise ValueError(
                    f"{key}.quaternion: length {np.linalg.norm(quaternion):.3g}, not 1; "
                    "give [x, y, z, w] of unit length"
                )
            pose[:3, :3] = rotation_from_quaternion(np.array(quaternion))
        else:
            angles = _numbers(f"{key}.rotation_rpy_deg", parts["rotation_rpy_deg"], 3)
            pose[:3, :3] = _rotation_from_rpy(np.radians(angles))
        return pose
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape not in ((3, 4), (4, 4)) or not np.isfinite(matrix).all():
        raise ValueError(
            f"{key}: give 3 or 4 rows of 4 numbers, "
            "or {translation, quaternion | rotation_rpy_deg}"
        )
    if matrix.shape == (4, 4) and not np.array_equal(matrix[3], (0, 0, 0, 1)):
        raise ValueError(f"{key}: the last row of a rigid transform is 0 0 0 1, not {matrix[3]}")
    pose[:3] = matrix[:3]
    rotation = pose[:3, :3]
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if error > ORTHONORMAL:
        raise ValueError(
            f"{key}: the rotation is not orthonormal (off by {error:.2g}); "
            "give more digits, and no scale"
        )
    if np.linalg.det(rotation) < 0:
        raise ValueError(
            f"{key}: the rotation mirrors (determinant -1); check the signs of an axis"
        )
    return pose


def _camera(key: str, value: Any) -> Camera:
    required = ("size", "fx", "fy", "cx", "cy")
    keys = _mapping(key, value, known=(*required, "distortion"))
    for name in required:
        if name not in keys:
            raise ValueError(f"{key}: {name} is missing; a camera needs {', '.join(required)}")
    width, height = (int(pixels) for pixels in _numbers(f"{key}.size", keys["size"], 2))
    if width < 2 or height < 2:
        raise ValueError(f"{key}.size: {width} x {height} is no image; give [width, height]")
    fx, fy, cx, cy = (float(_numbers(f"{key}.{n}", [keys[n]], 1)[0]) for n in required[1:])
    if fx <= 0 or fy <= 0:
        raise ValueError(f"{key}: fx and fy are focal lengths in pixels, above 0")
    k1, k2, p1, p2, k3 = _numbers(f"{key}.distortion", keys.get("distortion", [0.0] * 5), 5)
    return Camera((width, height), fx, fy, cx, cy, (k1, k2, p1, p2, k3))


def _mapping(key: str, value: Any, known: Sequence[str]) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ValueError(f"{key}: give the keys {', '.join(known)}")
    for name in value:
        if name not in known:
            close = difflib.get_close_matches(str(name), known, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(known)}"
            raise ValueError(f"{key}: unknown key '{name}'; {hint}")
    return value


def _numbers(key: str, value: Any, count: int) -> list[float]:
    numbers = value if isinstance(value, Sequence) and not isinstance(value, str) else ()
    sound = all(isinstance(x, int | float) and np.isfinite(x) for x in numbers)
    if len(numbers) != count or not sound:
        raise ValueError(f"{key}: give {count} finite number{'s' if count > 1 else ''}")
    return [float(x) for x in numbers]


def _rotation_from_rpy(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Yaw about z after pitch about y after roll about x, radians."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(angles), np.cos(angles)
    roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(yaw @ pitch @ roll)
