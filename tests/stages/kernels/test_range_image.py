"""Eq 18 against NumPy in float64."""

from __future__ import annotations

import numpy as np
import pytest

from stages.kernels.range_image import (
    as_remission,
    fill_channels,
    organized_cells,
    project_scan,
    ranges,
)

UP_DOWN = (-np.pi / 4, np.pi / 4)
MEAN = np.array([12.12, 10.88, 0.23, -1.04, 0.21], np.float32)
STD = np.array([12.32, 11.47, 6.91, 0.86, 0.16], np.float32)


def organized(rows: int = 128, columns: int = 1024, seed: int = 0) -> np.ndarray:
    """An organized scan (rows * columns, 3) of rough ground and walls; a tenth has no return."""
    rng = np.random.default_rng(seed)
    elevation = np.pi / 4 - (np.arange(rows)[:, None] + 0.5) * np.pi / 2 / rows
    azimuth = np.pi - (np.arange(columns) + 0.5) * 2 * np.pi / columns
    wall = 12 + 4 * np.sin(3 * azimuth) + rng.normal(0, 0.02, (rows, columns))
    r = np.where(elevation < -0.05, np.minimum(wall, 2 / -np.sin(elevation - 0.01)), wall)
    r[rng.random(r.shape) < 0.1] = 0
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    directions = np.stack([x, y, np.broadcast_to(np.sin(elevation), r.shape)], axis=-1)
    return (directions * r[..., None]).reshape(-1, 3).astype(np.float32)


def eq_18(points: np.ndarray, rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    p = points.astype(np.float64)
    r = np.linalg.norm(p, axis=1)
    with np.errstate(invalid="ignore"):
        u = 0.5 * (1 - np.arctan2(p[:, 1], p[:, 0]) / np.pi) * columns
        v = (1 - (np.arcsin(p[:, 2] / r) + np.pi / 4) / (np.pi / 2)) * rows
    inside = (r > 0) & (v >= 0) & (v <= rows)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    cell = np.minimum(v.astype(int), rows - 1) * columns + np.minimum(u.astype(int), columns - 1)
    cell = np.where(inside, cell, -1)
    nearest = np.full(rows * columns, -1)
    for i in np.argsort(-r, kind="stable"):
        if cell[i] >= 0:
            nearest[cell[i]] = i
    return cell, nearest.reshape(rows, columns)


@pytest.mark.parametrize("size", [(64, 512), (128, 1024)])
def test_the_projection_is_eq_18_with_the_nearest_point_kept(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    points = organized() * rng.uniform(0.5, 1.5, (131_072, 1)).astype(np.float32)
    points += rng.normal(0, 0.05, points.shape).astype(np.float32) * (points != 0)
    cell, nearest = eq_18(points, *size)
    found_nearest, found_cell, distance = project_scan(points, size, UP_DOWN)
    assert (found_cell == cell).mean() > 0.9995  # the rest lies on a border within 1e-6 rad
    assert (found_nearest == nearest).mean() > 0.9995
    np.testing.assert_allclose(distance, np.linalg.norm(points, axis=1), rtol=1e-6)


def test_point_0_is_kept_and_points_out_of_the_field_of_view_are_dropped() -> None:
    points = np.array([[5, 0, 0], [1, 0, 5], [0, 0, 0], [np.nan, 1, 1], [60, 0, 0]], np.float32)
    nearest, cell, distance = project_scan(points, (64, 512), UP_DOWN, 50.0)
    assert (cell >= 0).tolist() == [True, False, False, False, False]
    assert nearest.reshape(-1)[cell[0]] == 0
    assert (nearest >= 0).sum() == 1
    assert distance.tolist() == [5.0, pytest.approx(26**0.5), 0.0, 0.0, 60.0]
    np.testing.assert_array_equal(ranges(points), distance)


def test_an_organized_scan_needs_no_projection() -> None:
    points = organized()
    nearest, cell = organized_cells((128, 1024), (64, 512))
    by_row = points.reshape(128, 1024, 3)
    np.testing.assert_array_equal(points[nearest], by_row[::2, ::2])
    _, projected, distance = project_scan(points, (64, 512), UP_DOWN)
    measured = distance > 0
    np.testing.assert_array_equal(cell[measured], projected[measured])
    with pytest.raises(ValueError, match="128 x 1000 does not divide into 64 x 512"):
        organized_cells((128, 1000), (64, 512))


@pytest.mark.parametrize("depth", [4, 5])
def test_channels_are_normalized_and_0_without_a_return(depth: int) -> None:
    points, remission = organized(), np.random.default_rng(0).random(131_072).astype(np.float32)
    nearest, _ = organized_cells((128, 1024), (64, 512))
    planes = fill_channels(points, remission, nearest, MEAN[:depth], STD[:depth], 14.0)
    assert planes.shape == (depth, 64, 512)
    p = points.astype(np.float64)
    raw = np.column_stack([np.linalg.norm(p, axis=1), p, remission])[nearest.reshape(-1)]
    kept = (raw[:, :1] > 0) & (raw[:, :1] <= 14.0)
    assert 0.1 < kept.mean() < 0.85
    expected = ((raw - MEAN) / STD)[:, :depth] * kept
    assert np.abs(planes.reshape(depth, -1).T - expected).max() < 1e-5


def test_a_cell_without_a_point_is_0_though_the_first_point_is_not() -> None:
    points = np.full((2, 3), 3, np.float32)
    nearest = np.array([[-1, 1]], np.int32)
    planes = fill_channels(points, np.ones(2, np.float32), nearest, MEAN, STD)
    assert not planes[:, 0, 0].any()
    assert planes[:, 0, 1].all()


def test_a_remission_that_is_not_finite_costs_only_its_channel() -> None:
    points, nearest = np.full((1, 3), 3, np.float32), np.zeros((1, 1), np.int32)
    planes = fill_channels(points, np.array([np.nan], np.float32), nearest, MEAN, STD)
    assert planes[4, 0, 0] == 0
    assert planes[:4].all()


def test_a_sensor_without_remission_shows_the_mean() -> None:
    points = np.full((1, 3), 3, np.float32)
    planes = fill_channels(points, np.zeros(0, np.float32), np.zeros((1, 1), np.int32), MEAN, STD)
    assert planes[4, 0, 0] == 0


def test_remission_is_within_0_and_1() -> None:
    raw = np.array([0, 51, 255, 999, np.nan, np.inf])
    np.testing.assert_allclose(as_remission(raw, 255), [0, 0.2, 1, 1, 0, 0])
