"""Neighbors against brute force, surfaces of known thickness, blobs by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stages.kernels.neighbors import Cubes, blobs, nearest, thickness


@given(seed=st.integers(0, 10_000), n=st.integers(0, 60), radius=st.sampled_from([0.1, 0.7, 5.0]))
def test_the_nearest_is_the_nearest_of_all(seed: int, n: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    points, wanted = rng.normal(0, 1, (n, 3)).round(1), rng.normal(0, 2, (20, 3)).round(1)
    points[rng.random(n) < 0.1] = np.nan
    found = nearest(Cubes.of(points, radius), wanted)
    for query, row in zip(wanted, found, strict=True):
        square = ((points - query) ** 2).sum(axis=1)
        within = np.flatnonzero(square <= radius**2)
        best = within[np.argmin(square[within])] if len(within) else -1
        assert row == best


def test_points_that_are_not_finite_have_no_neighbors() -> None:
    cubes = Cubes.of(np.array([[np.nan, 0, 0], [0, 0, 0]]), 1.0)
    wanted = np.array([[0.5, 0, 0], [np.inf, 0, 0], [np.nan] * 3, [1e300, 0, 0], [-1e9, 0, 0]])
    assert nearest(cubes, wanted).tolist() == [1, -1, -1, -1, -1]
    assert nearest(Cubes.of(np.zeros((0, 3)), 1.0), wanted).tolist() == [-1] * 5
    with pytest.raises(ValueError, match="radius must be above 0"):
        Cubes.of(wanted, 0.0)
    with pytest.raises(ValueError, match="too far apart"):
        Cubes.of(np.array([[0.0, 0, 0], [1e9, 0, 0]]), 1.0)


@pytest.mark.parametrize("scatter_m", [0.01, 0.05, 0.1])
def test_a_slanted_surface_is_as_thick_as_its_points_scatter(scatter_m: float) -> None:
    rng = np.random.default_rng(0)
    flat = np.c_[rng.uniform(0, 6, (8_000, 2)), rng.normal(0, scatter_m, 8_000)]
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    measured = thickness(Cubes.of(flat @ turn + 100.0, 1.0), 8)
    assert np.median(measured) == pytest.approx(scatter_m, rel=0.1)


def test_thickness_stands_where_its_point_stands_and_needs_neighbors() -> None:
    rng = np.random.default_rng(1)
    sheet = np.c_[rng.uniform(0, 1, (50, 2)), np.zeros(50)]
    points = np.concatenate([[[50.0, 0, 0], [np.nan] * 3], sheet])
    measured = thickness(Cubes.of(points, 2.0), 8)
    assert np.isnan(measured[:2]).all()
    np.testing.assert_allclose(measured[2:], 0.0, atol=1e-6)


def test_blobs_touch_by_face_edge_or_corner_and_are_numbered_by_size() -> None:
    chain = [[0, 0, 0], [1, 1, 1], [2, 1, 1], [2, 2, 1]]
    pair, single = [[2, 2, 3], [2, 3, 4]], [[-7, 0, 0]]
    assert blobs(np.array(single + chain + pair)).tolist() == [2, 0, 0, 0, 0, 1, 1]
    assert blobs(np.zeros((0, 3), np.int64)).tolist() == []


@given(st.integers(0, 10_000))
def test_blobs_are_the_components_of_touching_voxels(seed: int) -> None:
    rng = np.random.default_rng(seed)
    voxels = np.unique(rng.integers(-4, 4, (40, 3)), axis=0)
    touching = np.abs(voxels[:, None] - voxels[None]).max(axis=2) <= 1
    reach = touching
    for _ in range(6):
        reach = (reach.astype(np.int64) @ reach) > 0
    group = blobs(voxels)
    assert ((group[:, None] == group[None]) == reach).all()
    assert (np.diff(np.bincount(group)) <= 0).all()
