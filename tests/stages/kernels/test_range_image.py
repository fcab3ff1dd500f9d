"""Eq 18 against NumPy in float64, and the way back to the points."""

from __future__ import annotations

import numpy as np
import pytest

from stages.kernels.probability import softmax
from stages.kernels.range_image import (
    adapted,
    as_remission,
    fill_channels,
    mean_and_std,
    moments,
    organized_cells,
    project_scan,
    ranges,
    rows_by_cell,
    rows_by_neighbors,
)

C = 15
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
    image, measured = fill_channels(points, remission, nearest, MEAN[:depth], STD[:depth])
    p = points.astype(np.float64)
    raw = np.column_stack([np.linalg.norm(p, axis=1), p, remission])[nearest.reshape(-1)]
    expected = ((raw - MEAN) / STD)[:, :depth] * (raw[:, :1] > 0)
    assert np.abs(image.reshape(-1, depth) - expected).max() < 1e-5
    np.testing.assert_allclose(measured.reshape(-1), raw[:, 0], rtol=1e-6)


def test_a_sensor_without_remission_shows_the_mean() -> None:
    points = np.full((1, 3), 3, np.float32)
    image, _ = fill_channels(points, np.zeros(0, np.float32), np.zeros((1, 1), np.int32), MEAN, STD)
    assert image[0, 0, 4] == 0


def scored(size: tuple[int, int], seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 2, (*size, 16)).astype(np.float32)


def test_a_point_takes_its_cell_s_scores_and_is_uniform_without_a_return() -> None:
    points, scores = organized(), scored((64, 512))
    nearest, cell = organized_cells((128, 1024), (64, 512))
    distance = ranges(points)
    measured = distance[nearest]
    rows, said = rows_by_cell(scores, measured, cell, distance, C)
    by_hand = (distance > 0) & (measured.reshape(-1)[cell] > 0)
    np.testing.assert_array_equal(said, by_hand)
    np.testing.assert_array_equal(rows[said, :C], scores.reshape(-1, 16)[cell[said], :C])
    assert not rows[~said, :C].any()


def neighbors_by_hand(
    probabilities: np.ndarray, measured: np.ndarray, cell: int, r: float
) -> np.ndarray:
    """SalsaNext's selection, in float64, with columns that go around."""
    rows, columns = measured.shape
    offsets = np.arange(5) - 2
    g = np.exp(-0.5 * (offsets[:, None] ** 2 + offsets**2))
    g /= g.sum()
    found = []
    for a, dv in enumerate(offsets):
        for b, du in enumerate(offsets):
            v, u = cell // columns + dv, (cell % columns + du) % columns
            if 0 <= v < rows and measured[v, u] > 0:
                gap = 0.0 if dv == du == 0 else abs(float(measured[v, u]) - r) * (1 - g[a, b])
                if gap <= 1.0:
                    found.append((gap, a * 5 + b, probabilities[v, u]))
    found.sort(key=lambda entry: entry[:2])
    return np.mean([p for _, _, p in found[:5]], axis=0)


def test_the_neighbors_of_a_point_are_those_of_salsanext_and_their_probabilities_average() -> None:
    points = organized(seed=5)
    size = (64, 512)
    nearest, cell, distance = project_scan(points, size, UP_DOWN)
    measured = np.where(nearest >= 0, distance[nearest], np.float32(0))
    probabilities = np.zeros((*size, 16), np.float32)
    probabilities[..., :C] = softmax(scored(size), C)
    rows, said = rows_by_neighbors(probabilities, measured, cell, distance, C)
    np.testing.assert_array_equal(said, cell >= 0)
    found = np.exp(rows[:, :C])
    assert np.abs(found[said].sum(axis=1) - 1).max() < 1e-4
    rng = np.random.default_rng(0)
    chosen = rng.choice(np.flatnonzero(said), 1_000)
    errors = [
        np.abs(
            neighbors_by_hand(probabilities, measured, cell[i], float(distance[i]))[:C] - found[i]
        ).max()
        for i in chosen
    ]
    # Two gaps closer than 4e-6 of themselves may change places.
    assert np.quantile(errors, 0.995) < 2e-6


def test_the_classes_of_a_wall_do_not_bleed_onto_the_pole_before_it() -> None:
    measured = np.full((9, 9), 20.0, np.float32)
    measured[:, 4] = 5.0
    probabilities = np.zeros((9, 9, 16), np.float32)
    probabilities[..., 1] = 1.0
    probabilities[:, 4, 1], probabilities[:, 4, 14] = 0.0, 1.0
    wall_behind_the_pole = np.array([4 * 9 + 4], np.int32), np.array([20.0], np.float32)
    rows, _ = rows_by_neighbors(probabilities, measured, *wall_behind_the_pole, C)
    assert rows[0, :C].argmax() == 1


def test_statistics_of_parts_add_up_to_those_of_all() -> None:
    points = organized()
    remission = np.linspace(0, 1, len(points), dtype=np.float32)
    raw = []
    for half in (slice(0, 65_536), slice(65_536, None)):
        nearest = np.arange(65_536, dtype=np.int32).reshape(64, 1024)
        none, one = np.zeros(5, np.float32), np.ones(5, np.float32)
        raw.append(moments(*fill_channels(points[half], remission[half], nearest, none, one)))
    mean, std = mean_and_std(raw[0] + raw[1])
    kept = points.any(axis=1)
    p = points[kept].astype(np.float64)
    values = np.column_stack([np.linalg.norm(p, axis=1), p, remission[kept]])
    np.testing.assert_allclose(mean, values.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(std, values.std(axis=0), rtol=1e-4)
    np.testing.assert_array_equal(adapted(MEAN, mean), [*MEAN[:3], *mean[3:]])


def test_remission_is_within_0_and_1() -> None:
    raw = np.array([0, 51, 255, 999, np.nan, np.inf])
    np.testing.assert_allclose(as_remission(raw, 255), [0, 0.2, 1, 1, 0, 0])


@pytest.mark.slow
def test_10_000_degenerate_scans_give_no_exception_and_no_nan() -> None:
    rng = np.random.default_rng(11)
    scores = scored((8, 16))
    probabilities = np.zeros((8, 16, 16), np.float32)
    probabilities[..., :C] = softmax(scores, C)
    for _ in range(10_000):
        n = int(rng.integers(0, 12))
        points = rng.normal(0, 10 ** rng.uniform(-3, 20), (n, 3)).astype(np.float32)
        points[rng.random((n, 3)) < 0.2] = rng.choice([np.nan, np.inf, -np.inf, 0, 1e38, 1])
        if n and rng.random() < 0.2:
            points[:] = points[0]
        with np.errstate(over="ignore"):
            nearest, cell, distance = project_scan(points, (8, 16), UP_DOWN)
        image, measured = fill_channels(points, points[:, 0].copy(), nearest, MEAN, STD)
        assert np.isfinite(image).all()
        assert np.isfinite(distance).all()
        for rows, said in (
            rows_by_cell(scores, measured, cell, distance, C),
            rows_by_neighbors(probabilities, measured, cell, distance, C),
        ):
            assert np.isfinite(rows).all()
            assert (said == (cell >= 0)).all()
