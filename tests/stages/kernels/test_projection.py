"""The camera model against a float64 oracle and its own inverse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.kernels.geometry import rotation_exp
from stages.kernels.projection import MIN_DEPTH_M, fold_limit, project, unproject

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
