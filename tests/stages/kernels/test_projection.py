"""The camera model against a float64 oracle and its own inverse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.kernels.geometry import rotation_exp
from stages.kernels.projection import (
    HIDES_M,
    HIDES_SHARE,
    MIN_DEPTH_M,
    fold_limit,
    hidden,
    project,
    unproject,
)

PLAIN = np.array([500.0, 510.0, 420.0, 240.0, 0, 0, 0, 0, 0])
BARREL = np.array([500.0, 510.0, 420.0, 240.0, -0.3, 0.08, 1e-3, -5e-4, 0.0])


def oracle(points: np.ndarray, transform: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, ...]:
    """u, v and Z in float64, straight from the equations."""
    p = points.astype(np.float64) @ transform[:3, :3].T + transform[:3, 3]
    x, y = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
    r2 = x**2 + y**2
    d = 1 + k[4] * r2 + k[5] * r2**2 + k[8] * r2**3
    u = k[0] * (x * d + 2 * k[6] * x * y + k[7] * (r2 + 2 * x**2)) + k[2]
    v = k[1] * (y * d + k[6] * (r2 + 2 * y**2) + 2 * k[7] * x * y) + k[3]
    return u, v, p[:, 2], r2


@pytest.mark.parametrize("intrinsics", [PLAIN, BARREL])
def test_projection_equals_the_equations(intrinsics: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    points = (rng.random((20_000, 3)) * 60 - 30).astype(np.float32)
    transform = np.eye(4)
    transform[:3, :3] = rotation_exp(np.array([0.3, -0.2, 0.1]))
    transform[:3, 3] = (0.2, -0.1, 0.3)
    usable = rng.random(len(points)) < 0.9
    limit = fold_limit(intrinsics)
    index, pixel, distance = project(points, usable, transform, intrinsics, 848, 480, limit)

    u, v, z, r2 = oracle(points, transform, intrinsics)
    seen = usable & (z > MIN_DEPTH_M) & (r2 < limit)
    seen &= (u >= 0) & (u <= 847) & (v >= 0) & (v <= 479)
    assert index.tolist() == np.flatnonzero(seen).tolist()
    assert np.abs(pixel - np.stack([u, v], axis=1)[index]).max() < 1e-4  # seen: 3e-5, float32
    moved = points[index] @ transform[:3, :3].T + transform[:3, 3]
    np.testing.assert_allclose(distance, np.linalg.norm(moved, axis=1), rtol=1e-5)


@settings(deadline=None)  # the first example compiles
@given(st.floats(0, 847), st.floats(0, 479), st.floats(0.5, 80), st.sampled_from([PLAIN, BARREL]))
def test_projecting_an_unprojected_pixel_returns_it(
    u: float, v: float, depth: float, intrinsics: np.ndarray
) -> None:
    point = unproject(np.array([[u, v]]), np.array([depth]), intrinsics)
    assert point[0, 2] == depth
    width, height = 10_000, 10_000  # far edges: rounding may push a border pixel out
    shifted = intrinsics.copy()
    shifted[2:4] += 1_000
    index, pixel, _ = project(
        point.astype(np.float32), np.ones(1, bool), np.eye(4), shifted, width, height, np.inf
    )
    assert index.tolist() == [0]
    np.testing.assert_allclose(pixel[0] - 1_000, (u, v), atol=2e-3)


def test_distortion_does_not_fold_far_points_back_into_the_image() -> None:
    strong = np.array([500.0, 510.0, 420.0, 240.0, -0.3, 0, 0, 0, 0])
    limit = fold_limit(strong)
    radius = np.sqrt(limit)
    edge = strong[0] * radius * (1 + strong[4] * limit) + strong[2]
    inside, beyond = np.array([0.99 * radius, 0, 1]), np.array([1.5 * radius, 0, 1])
    u, _, _, _ = oracle(np.stack([inside, beyond]), np.eye(4), strong)
    assert 0 < u[1] < edge  # the equations alone fold it back
    points = np.stack([inside, beyond]).astype(np.float32)
    index, _, _ = project(points, np.ones(2, bool), np.eye(4), strong, 2_000, 2_000, limit)
    assert index.tolist() == [0]


def test_without_distortion_nothing_folds() -> None:
    assert fold_limit(PLAIN) == np.inf


def test_points_behind_the_camera_are_not_seen() -> None:
    points = np.array([[0, 0, -5], [0, 0, 0], [0, 0, 0.09], [0, 0, 5]], np.float32)
    index, _, _ = project(points, np.ones(4, bool), np.eye(4), PLAIN, 848, 480, np.inf)
    assert index.tolist() == [3]


def test_a_point_is_hidden_by_a_nearer_one_above_or_beside_it_but_not_below() -> None:
    near, far = 5.0, 10.0
    pixel = np.array([[50, 40], [50, 43], [53, 40], [50, 37], [50, 46]], np.float32)
    distance = np.array([near, far, far, far, far], np.float32)
    found = hidden(pixel, distance, (100, 80), 4)
    assert found.tolist() == [False, True, True, False, False]
    assert not hidden(pixel, np.full(5, far, np.float32), (100, 80), 4).any()
    assert hidden(pixel[:0], distance[:0], (100, 80), 4).shape == (0,)


def test_open_ground_hides_nothing_of_itself_and_a_wall_what_stands_behind_it() -> None:
    x, y = np.meshgrid(np.linspace(-8, 8, 161), np.geomspace(3, 40, 80))
    ground = np.stack([x.ravel(), np.full(x.size, 1.7), y.ravel()], axis=1)
    across, up = np.meshgrid(np.linspace(-2, 2, 81), np.linspace(0, 1.7, 35))
    wall = np.stack([across.ravel(), up.ravel(), np.full(up.size, 8.0)], axis=1)
    points = np.concatenate([ground, wall]).astype(np.float32)
    usable = np.ones(len(points), bool)
    camera = np.array([400.0, 400.0, 424.0, 240.0, 0, 0, 0, 0, 0])

    index, pixel, distance = project(points, usable, np.eye(4), camera, 848, 480, np.inf)
    found = np.zeros(len(points), bool)
    found[index] = hidden(pixel, distance, (848, 480), 6)
    reached = points[:, :2] / points[:, 2:] * 8.0  # where the ray goes through the wall's plane
    behind = (points[:, 2] > 9.5) & (np.abs(reached[:, 0]) < 2) & (reached[:, 1] < 1.7)
    assert found[behind].mean() > 0.99
    beside = np.abs(reached[:, 0]) > 2.2
    assert not found[beside | (points[:, 2] <= 8)].any()


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 9))
def test_hidden_agrees_with_looking_at_every_pair(seed: int, reach: int) -> None:
    rng = np.random.default_rng(seed)
    pixel = (rng.random((40, 2)) * (59, 39)).astype(np.float32)
    distance = rng.uniform(1, 20, 40).astype(np.float32)
    u, v = np.rint(pixel).astype(int).T
    near = (np.abs(u[:, None] - u) <= reach) & (v <= v[:, None]) & (v[:, None] - v <= reach)
    least = np.where(near, distance, np.inf).min(axis=1)
    expected = distance > least * (1 + HIDES_SHARE) + HIDES_M
    assert hidden(pixel, distance, (60, 40), reach).tolist() == expected.tolist()
