"""Rigid motion against plain formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from stages.kernels.geometry import (
    KNOT_NS,
    MAX_EXTRAPOLATION_NS,
    deskew,
    has_return,
    interpolate_poses,
    invert,
    rotation_exp,
    rotation_from_quaternion,
    rotation_log,
    sweep_knots,
)

vectors = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)


def pose(vector: NDArray[np.float64], translation: tuple[float, float, float]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_exp(np.asarray(vector, dtype=np.float64))
    matrix[:3, 3] = translation
    return matrix


def series_exp(vector: NDArray[np.float64]) -> np.ndarray:
    """The exponential series of the cross-product matrix: the definition of a rotation vector."""
    x, y, z = vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return sum(np.linalg.matrix_power(cross, n) / math.factorial(n) for n in range(40))


@given(vectors, st.sampled_from([1e-12, 1e-8, 1e-3, 1.0, 1.8]))
def test_the_exponential_is_its_series_and_the_logarithm_its_inverse(
    direction: NDArray[np.float64], size: float
) -> None:
    vector = direction * size
    rotation = rotation_exp(vector)
    np.testing.assert_allclose(rotation, series_exp(vector), atol=1e-12)
    np.testing.assert_allclose(rotation_log(rotation), vector, atol=1e-9)


@given(vectors.filter(lambda v: np.linalg.norm(v) > 0.1), st.floats(-1e-7, 0.0))
def test_the_logarithm_holds_up_to_half_a_turn(axis: NDArray[np.float64], less: float) -> None:
    vector = axis / np.linalg.norm(axis) * (math.pi + less)
    recovered = rotation_log(rotation_exp(vector))
    np.testing.assert_allclose(rotation_exp(recovered), rotation_exp(vector), atol=1e-9)
    assert np.linalg.norm(recovered) == pytest.approx(math.pi, abs=1e-6)


def test_a_quaternion_turns_like_its_rotation_vector() -> None:
    axis = np.array([0.6, 0.0, 0.8])
    quaternion = np.array([*(axis * math.sin(0.35)), math.cos(0.35)])
    np.testing.assert_allclose(
        rotation_from_quaternion(quaternion), rotation_exp(axis * 0.7), atol=1e-12
    )


@given(vectors, vectors)
def test_a_transform_times_its_inverse_is_the_identity(
    turn: NDArray[np.float64], shift: NDArray[np.float64]
) -> None:
    there = pose(turn, tuple(shift * 100))
    np.testing.assert_allclose(there @ invert(there), np.eye(4), atol=1e-12)


def test_a_trajectory_is_its_poses_at_their_stamps_and_half_way_between() -> None:
    stamps = np.array([0, 100_000_000])
    poses = np.stack([pose([0, 0, 0.1], (0, 0, 0)), pose([0, 0, 0.3], (2, 0, 0))])
    found, covered = interpolate_poses(stamps, poses, np.array([0, 50_000_000, 100_000_000]))
    assert covered.all()
    np.testing.assert_allclose(found[[0, 2]], poses, atol=1e-12)
    np.testing.assert_allclose(found[1], pose([0, 0, 0.2], (1, 0, 0)), atol=1e-12)


def test_extrapolation_keeps_the_twist_and_ends_after_100_ms() -> None:
    stamps = np.array([0, 100_000_000])
    poses = np.stack([np.eye(4), pose([0, 0, 0.2], (1, 0, 0))])
    times = np.array([-MAX_EXTRAPOLATION_NS, stamps[1] + MAX_EXTRAPOLATION_NS])
    found, covered = interpolate_poses(stamps, poses, times)
    assert covered.all()
    np.testing.assert_allclose(found[0], pose([0, 0, -0.2], (-1, 0, 0)), atol=1e-12)
    np.testing.assert_allclose(found[1], pose([0, 0, 0.4], (2, 0, 0)), atol=1e-12)
    beyond = times + np.array([-1, 1])
    assert not interpolate_poses(stamps, poses, beyond)[1].any()


def test_a_single_pose_stands_still_near_its_stamp() -> None:
    alone = pose([0, 0.1, 0], (1, 2, 3))
    found, covered = interpolate_poses(
        np.array([0]), alone[None], np.array([50_000_000, 2 * MAX_EXTRAPOLATION_NS])
    )
    assert covered.tolist() == [True, False]
    np.testing.assert_array_equal(found[0], alone)


@given(st.integers(-(10**9), 10**9), st.integers(0, 10**8))
def test_knots_span_the_sweep_evenly_and_closely(first: int, length: int) -> None:
    knots = sweep_knots(first, first + length)
    assert (knots[0], knots[-1]) == (first, first + length)
    assert len(knots) >= 2
    assert np.diff(knots).max() <= KNOT_NS + 1


def test_deskew_moves_each_point_by_the_motion_since_its_own_time() -> None:
    rng = np.random.default_rng(1)
    n, period = 2_000, 100_000_000
    times = rng.integers(-period, 1, n).astype(np.int32)
    points = (rng.random((n, 3)) * 100 - 50).astype(np.float32)
    stamps = np.array([-period, 0])
    poses = np.stack([pose([0.1, -0.05, 0.2], (1.0, 0.2, -0.3)), np.eye(4)])  # 2 rad/s, 11 m/s
    knots = sweep_knots(int(times.min()), int(times.max()))
    motion, _ = interpolate_poses(stamps, poses, knots)
    moved = deskew(points, times, int(knots[0]), int(knots[-1]), motion)

    exact, _ = interpolate_poses(stamps, poses, times.astype(np.int64))
    oracle = np.einsum("nij,nj->ni", exact[:, :3, :3], points.astype(float)) + exact[:, :3, 3]
    assert np.abs(moved - oracle).max() < 2e-4  # seen: 9e-5 m, the chord between knots at 87 m


def test_deskew_leaves_what_has_no_return_without_one() -> None:
    points = np.array([[0, 0, 0], [0, 0, 1], [0, 0, 0]], np.float32)
    times = np.array([0, 50, 100], np.int32)
    motion = np.stack([np.eye(4), pose([0, 0, 0.5], (30.0, 0, 0))])
    moved = deskew(points, times, 0, 100, motion)
    assert moved.any(axis=1).tolist() == [False, True, False]


def test_a_return_is_finite_and_farther_than_the_vehicle() -> None:
    points = np.array(
        [[0, 0, 0], [0.5, 0, 0], [0, 1, 0], [np.nan, 9, 9], [np.inf, 0, 0], [9, 9, 9]], np.float32
    )
    assert has_return(points, 1.0).tolist() == [False, False, True, False, False, True]
    assert has_return(points, 0.0).tolist() == [False, True, True, False, False, True]
