"""The ground of a map, and what may not lie on it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from stages.kernels.ground import fit_plane, heights, lowest_in_columns, without_smear

GROUND = np.zeros(16, np.bool_)
GROUND[3] = True  # road


def street(slope: float = 0.0, seed: int = 0) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """A sloped road of 40 m with a wall beside it and a flat roof over a third of it; and the true
    height of each position above the road."""
    random = np.random.default_rng(seed)
    road = random.uniform([-20, -20, 0], [20, 20, 0], (4000, 3))
    wall = random.uniform([-20, 6, 0.3], [20, 6.2, 6], (3000, 3))
    roof = random.uniform([-20, 7, 6], [20, 19, 6], (1500, 3))
    road[:, 2] += random.normal(0, 0.02, len(road))
    positions = np.concatenate([road, wall, roof])
    height = positions[:, 2].copy()
    height[: len(road)] = 0
    positions[:, 2] += slope * positions[:, 0]
    return positions.astype(np.float32), height


@pytest.mark.parametrize("tile_m", [None, 20.0])
@pytest.mark.parametrize("slope", [0.0, 0.08])
def test_heights_are_above_the_road_beside_walls_and_under_roofs(
    slope: float, tile_m: float | None
) -> None:
    positions, true = street(slope)
    found = heights(positions, tile_m=tile_m)
    np.testing.assert_allclose(found, true * np.cos(np.arctan(slope)), atol=0.1)


def test_a_bend_in_the_road_needs_tiles() -> None:
    x = np.arange(-40, 40, 0.25)
    x, y = (axis.ravel() for axis in np.meshgrid(x, np.arange(-5, 5, 0.25)))
    positions = np.stack([x, y, np.maximum(0, 0.12 * x)], axis=1).astype(np.float32)
    tiled = heights(positions, tile_m=20.0)
    assert np.mean(abs(tiled) < 0.2) > 0.95
    assert np.mean(abs(heights(positions, tile_m=None)) < 0.2) < 0.9


def test_a_wall_alone_is_no_ground() -> None:
    wall = np.random.default_rng(0).uniform([0, 0, 0], [10, 0.02, 5], (500, 3))
    assert fit_plane(wall) is None
    assert fit_plane(wall[:10]) is None
    assert np.isnan(heights(wall[:10].astype(np.float32))).all()


def test_the_plane_is_that_of_the_points_far_from_the_origin() -> None:
    random = np.random.default_rng(1)
    flat = random.uniform(-10, 10, (400, 2)) + np.array([4e5, 5e6])
    z = 120 + 0.05 * (flat[:, 0] - 4e5) + random.normal(0, 0.02, 400)
    plane = fit_plane(np.column_stack([flat, z]))
    assert plane is not None
    assert plane[2] == pytest.approx(np.cos(np.arctan(0.05)), abs=1e-4)
    above = np.array([4e5, 5e6, 123.0])
    assert plane[:3] @ above + plane[3] == pytest.approx(3 * plane[2], abs=0.02)


def test_the_same_map_gives_the_same_heights() -> None:
    positions, _ = street(0.03)
    np.testing.assert_array_equal(heights(positions), heights(positions.copy()))


def test_the_lowest_of_each_column_are_candidates() -> None:
    positions = np.array([[0.1, 0.1, 2], [0.2, 0.3, 1], [0.7, 0.1, 5]], np.float32)
    assert sorted(lowest_in_columns(positions)) == [1, 2]


def test_what_lies_on_the_ground_and_is_no_ground_becomes_unknown() -> None:
    labels = np.array([13, 13, 3, 13, 13], np.uint8)
    height = np.array([0.0, 0.5, 0.0, -0.19, np.nan])
    fixed = without_smear(labels, height, GROUND, reach_m=0.2)
    assert fixed.tolist() == [0, 13, 3, 0, 13]
