"""Rigid motion: rotations, interpolated trajectories (eq 1) and moving points between frames.

Transforms are (4, 4) float64; ``a_from_b`` takes points of b into a. Angles are radians, times
integer nanoseconds.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled

#: How far beyond its ends a trajectory is continued at constant twist.
MAX_EXTRAPOLATION_NS = 100_000_000

#: Most that two knots of a sweep may lie apart. Between knots matrices are interpolated linearly:
#: at 3 rad/s that is off by (3 * 0.002)^2 / 8 = 5e-6 rad, 0.2 mm at 50 m.
KNOT_NS = 2_000_000


def invert(transform: NDArray[np.float64]) -> NDArray[np.float64]:
    """The inverse of rigid transforms (..., 4, 4)."""
    inverse = np.zeros_like(transform)
    rotation = np.swapaxes(transform[..., :3, :3], -1, -2)
    inverse[..., :3, :3] = rotation
    inverse[..., :3, 3] = -(rotation @ transform[..., :3, 3:])[..., 0]
    inverse[..., 3, 3] = 1.0
    return inverse


def rotation_exp(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), by Rodrigues' formula."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    small = angle < 1e-6
    safe = np.where(small, 1.0, angle)
    sine = np.where(small, 1.0, np.sin(safe) / safe)
    versine = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1)
    cross = cross.reshape(*vector.shape[:-1], 3, 3)
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))


def rotation_log(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation vectors (..., 3) of rotation matrices (..., 3, 3), of angles up to pi."""
    # By way of the quaternion, which keeps its precision at small angles and near pi.
    m = rotation
    diagonal = np.stack([m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]], axis=-1)
    trace = diagonal.sum(axis=-1)
    squares = np.concatenate(
        [2 * diagonal - trace[..., None] + 1.0, (trace + 1.0)[..., None]], axis=-1
    )  # 4 q_i^2, in the order x y z w
    product = np.empty((*trace.shape, 4, 4))  # 4 q_i q_j
    for i in range(4):
        product[..., i, i] = squares[..., i]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        product[..., i, j] = product[..., j, i] = m[..., i, j] + m[..., j, i]
    for axis, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        product[..., axis, 3] = product[..., 3, axis] = m[..., i, j] - m[..., j, i]
    best = np.argmax(squares, axis=-1)[..., None, None]
    quaternion = np.take_along_axis(product, best, axis=-2)[..., 0, :]
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    quaternion *= np.where(quaternion[..., 3:] < 0, -1.0, 1.0)
    sine = np.linalg.norm(quaternion[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, quaternion[..., 3:])
    factor = np.where(sine < 1e-9, 2.0, angle / np.where(sine < 1e-9, 1.0, sine))
    return np.asarray(factor * quaternion[..., :3])


def rotation_from_quaternion(xyzw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrix (3, 3) of a quaternion x y z w, of any length above 0."""
    x, y, z, w = xyzw / np.linalg.norm(xyzw)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def interpolate_poses(
    stamps: NDArray[np.int64], poses: NDArray[np.float64], times: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Poses (k, 4, 4) at `times` (k,), and whether the trajectory covers each (k,).

    `stamps` (n,) increasing, `poses` (n, 4, 4), n >= 1. Between neighbors with a = (t - t_i) /
    (t_(i+1) - t_i): R = R_i exp(a log(R_i^T R_(i+1))), p linear. Outside, the motion of the
    outermost pair goes on, covered for at most `MAX_EXTRAPOLATION_NS`; a single pose stands still.
    """
    if len(stamps) == 1:
        still = np.broadcast_to(poses[0], (len(times), 4, 4)).copy()
        return still, np.abs(times - stamps[0]) <= MAX_EXTRAPOLATION_NS
    covered = times >= stamps[0] - MAX_EXTRAPOLATION_NS
    covered &= times <= stamps[-1] + MAX_EXTRAPOLATION_NS
    before = np.clip(np.searchsorted(stamps, times, side="right") - 1, 0, len(stamps) - 2)
    step = (times - stamps[before]) / (stamps[before + 1] - stamps[before])
    first, second = poses[before], poses[before + 1]
    turn = rotation_log(np.swapaxes(first[:, :3, :3], 1, 2) @ second[:, :3, :3])
    result = np.zeros((len(times), 4, 4))
    result[:, :3, :3] = first[:, :3, :3] @ rotation_exp(step[:, None] * turn)
    result[:, :3, 3] = first[:, :3, 3] + step[:, None] * (second[:, :3, 3] - first[:, :3, 3])
    result[:, 3, 3] = 1.0
    return result, covered


def sweep_knots(first_ns: int, last_ns: int) -> NDArray[np.int64]:
    """Evenly spaced instants (k >= 2,) from `first_ns` to `last_ns`, at most `KNOT_NS` apart."""
    count = 2 + max(0, last_ns - first_ns - 1) // KNOT_NS
    return np.linspace(first_ns, last_ns, count).round().astype(np.int64)


@compiled
def deskew(
    points: NDArray[np.float32],
    times_ns: NDArray[np.int32],
    first_ns: int,
    last_ns: int,
    reference_from_sensor: NDArray[np.float64],
) -> Any:
    """Move the points (n, 3) of a sweep, each measured at its own time (n,), into one frame.

    `reference_from_sensor` (k, 4, 4) are the transforms at k even instants from `first_ns` to
    `last_ns` (`sweep_knots`), interpolated linearly between. Returns (n, 3) float32; what has no
    return (0, 0, 0) stays so.
    """
    knots = len(reference_from_sensor)
    per_ns = (knots - 1) / max(last_ns - first_ns, 1)
    moved = np.empty_like(points)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if x == 0 and y == 0 and z == 0:
            moved[i] = 0
            continue
        position = (times_ns[i] - first_ns) * per_ns
        knot = min(max(int(position), 0), knots - 2)
        b = position - knot
        a = 1.0 - b
        for row in range(3):
            p = reference_from_sensor[knot, row]
            q = reference_from_sensor[knot + 1, row]
            moved[i, row] = (
                (a * p[0] + b * q[0]) * x
                + (a * p[1] + b * q[1]) * y
                + (a * p[2] + b * q[2]) * z
                + (a * p[3] + b * q[3])
            )
    return moved


@compiled
def has_return(points: NDArray[np.float32], min_range_m: float) -> Any:
    """(n,) bool: the point (n, 3) is finite and at least `min_range_m` from the sensor."""
    result = np.empty(len(points), dtype=np.bool_)
    least = min_range_m * min_range_m
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        square = x * x + y * y + z * z
        result[i] = square >= least and square < np.inf and square > 0.0
    return result
