"""Sampled scores against a float64 oracle that dequantizes everything first."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.kernels.sampling import sample_scores

CLASSES = 15


def oracle(grid: np.ndarray, rects: np.ndarray, pixel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values in float64, one pixel and tile at a time; grid already dequantized."""
    total = np.zeros((len(pixel), CLASSES))
    weights = np.zeros(len(pixel))
    _, rows, columns, _ = grid.shape
    for i, (u, v) in enumerate(pixel.astype(np.float64)):
        x, y = u + 0.5, v + 0.5
        for tile, (x0, y0, x1, y1) in enumerate(rects.astype(np.float64)):
            if not (x0 <= x <= x1 and y0 <= y <= y1):
                continue
            c = (x - x0) / (x1 - x0) * columns - 0.5
            r = (y - y0) / (y1 - y0) * rows - 0.5
            c, r = np.clip(c, 0, columns - 1), np.clip(r, 0, rows - 1)
            c0, r0 = min(int(c), columns - 2), min(int(r), rows - 2)
            a, b = c - c0, r - r0
            corners = grid[tile, r0 : r0 + 2, c0 : c0 + 2, :CLASSES]
            value = (1 - b) * ((1 - a) * corners[0, 0] + a * corners[0, 1])
            value += b * ((1 - a) * corners[1, 0] + a * corners[1, 1])
            weight = min(x - x0, x1 - x) * min(y - y0, y1 - y) / ((x1 - x0) * (y1 - y0)) + 1e-6
            total[i] += weight * value
            weights[i] += weight
    covered = weights > 0
    total[covered] /= weights[covered, None]
    return total, covered


TILES = np.array([[0, 0, 60, 40], [30, 0, 100, 40], [0, 0, 100, 40]], np.float32)


@pytest.mark.parametrize("kind", [np.float32, np.int8, np.uint8])
@pytest.mark.parametrize("tiles", [1, 3])
def test_sampling_equals_dequantizing_first(kind: type, tiles: int) -> None:
    rng = np.random.default_rng(3)
    grid = rng.integers(0, 120, (tiles, 5, 9, 16)).astype(kind)
    pixel = (rng.random((500, 2)) * (110, 40) - 0.5).astype(np.float32)
    scale, zero_point = 0.2, 82
    values, covered = sample_scores(grid, TILES[:tiles], scale, float(zero_point), pixel, CLASSES)
    expected, within = oracle((grid.astype(float) - zero_point) * scale, TILES[:tiles], pixel)
    assert covered.tolist() == within.tolist()
    assert np.abs(values[:, :CLASSES] - expected).max() < 2e-5  # seen: 7e-6 of values to 16
    assert not values[:, CLASSES:].any()
    assert 0 < (~covered).sum() < 300


def test_a_channel_first_grid_is_sampled_through_its_strided_view() -> None:
    rng = np.random.default_rng(4)
    planar = rng.normal(size=(1, 16, 6, 7)).astype(np.float32)
    view = planar.transpose(0, 2, 3, 1)
    pixel = (rng.random((50, 2)) * (59, 39)).astype(np.float32)
    rest = (1.0, 0.0, pixel, CLASSES)
    strided, _ = sample_scores(view, TILES[:1], *rest)
    packed, _ = sample_scores(np.ascontiguousarray(view), TILES[:1], *rest)
    np.testing.assert_array_equal(strided, packed)


@settings(deadline=None)  # the first example compiles
@given(st.integers(0, 59), st.integers(0, 39))
def test_a_full_resolution_grid_gives_back_its_own_pixels(u: int, v: int) -> None:
    grid = np.zeros((1, 40, 60, 16), np.float32)
    grid[0, :, :, 0], grid[0, :, :, 1] = np.mgrid[:40, :60]
    values, covered = sample_scores(
        grid, TILES[:1], 1.0, 0.0, np.array([[u, v]], np.float32), CLASSES
    )
    assert covered[0]
    np.testing.assert_allclose(values[0, :2], (v, u), atol=1e-4)


def test_tiles_meet_without_a_step() -> None:
    """At a tile's edge its weight is 0, so the sum passes on to the other tile smoothly."""
    grid = np.zeros((2, 2, 2, 16), np.float32)
    grid[1] = 1.0
    u = np.linspace(0, 99, 1_000, dtype=np.float32)
    pixel = np.stack([u, np.full_like(u, 20)], axis=1)
    values, _ = sample_scores(grid, TILES[:2], 1.0, 0.0, pixel, CLASSES)
    assert (values[u < 29, 0] == 0).all()
    assert values[u > 60, 0] == pytest.approx(1)
    assert np.abs(np.diff(values[:, 0])).max() < 0.01


def test_a_grid_without_cells_covers_nothing() -> None:
    pixel = np.zeros((40, 2), np.float32)
    for shape in ((0, 4, 6, 16), (1, 0, 6, 16), (1, 4, 0, 16)):
        grid = np.zeros(shape, np.float32)
        values, covered = sample_scores(grid, TILES[:1], 1.0, 0.0, pixel, CLASSES)
        assert not covered.any()
        assert not values.any()


def test_a_grid_of_one_cell_is_that_cell_everywhere() -> None:
    grid = np.full((1, 1, 1, 16), 3.0, np.float32)
    pixel = np.array([[0, 0], [30, 20], [59, 39]], np.float32)
    values, _ = sample_scores(grid, TILES[:1], 1.0, 0.0, pixel, CLASSES)
    np.testing.assert_allclose(values[:, :CLASSES], 3.0, rtol=1e-6)


@pytest.mark.parametrize(
    "rect", [[np.nan] * 4, [5, 5, 5, 5], [9, 9, 1, 1], [0, 0, np.inf, 40], [-np.inf, 0, 60, 40]]
)
def test_a_rectangle_without_sense_gives_finite_scores_or_none(rect: list[float]) -> None:
    grid = np.ones((2, 4, 6, 16), np.float32)
    rects = np.array([rect, [50, 30, 60, 40]], np.float32)
    pixel = np.stack(np.meshgrid(np.arange(-1, 62) - 0.5, np.arange(-1, 42) - 0.5), -1)
    pixel = pixel.reshape(-1, 2).astype(np.float32)
    for tiles in (1, 2):
        values, covered = sample_scores(grid[:tiles], rects[:tiles], 1.0, 0.0, pixel, CLASSES)
        assert np.isfinite(values).all()
        assert not values[~covered].any()
