"""The way from a range image back to the points, against NumPy in float64."""

from __future__ import annotations

import numpy as np
import pytest

from stages.kernels.probability import softmax
from stages.kernels.range_image import fill_channels, organized_cells, project_scan, ranges
from stages.kernels.scan_scores import rows_by_cell, rows_by_neighbors

C = 15
UP_DOWN = (-np.pi / 4, np.pi / 4)
MEAN = np.array([12.12, 10.88, 0.23, -1.04, 0.21], np.float32)
STD = np.array([12.32, 11.47, 6.91, 0.86, 0.16], np.float32)


def organized(seed: int = 0) -> np.ndarray:
    """An organized scan (128 * 1024, 3) of rough walls; a tenth has no return."""
    rng = np.random.default_rng(seed)
    elevation = np.pi / 4 - (np.arange(128)[:, None] + 0.5) * np.pi / 256
    azimuth = np.pi - (np.arange(1024) + 0.5) * np.pi / 512
    r = 12 + 4 * np.sin(3 * azimuth) + rng.normal(0, 0.02, (128, 1024))
    r[rng.random(r.shape) < 0.1] = 0
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    directions = np.stack([x, y, np.broadcast_to(np.sin(elevation), r.shape)], axis=-1)
    return (directions * r[..., None]).reshape(-1, 3).astype(np.float32)


def scored(size: tuple[int, int], seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 2, (*size, 16)).astype(np.float32)


def test_a_point_takes_its_cell_s_scores_and_is_uniform_without_a_return() -> None:
    points, scores = organized(), scored((64, 512))
    nearest, cell = organized_cells((128, 1024), (64, 512))
    distance = ranges(points)
    rows, said = rows_by_cell(scores, nearest, cell, distance, C)
    by_hand = (distance > 0) & (distance[nearest].reshape(-1)[cell] > 0)
    np.testing.assert_array_equal(said, by_hand)
    np.testing.assert_array_equal(rows[said, :C], scores.reshape(-1, 16)[cell[said], :C])
    assert not rows[~said, :C].any()
    assert (rows[:, C:] == -1e4).all()


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
    rows, said = rows_by_neighbors(probabilities, nearest, cell, distance, C)
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


def test_a_point_in_a_cell_without_a_return_is_told_by_its_neighbors_in_range() -> None:
    nearest = np.zeros((9, 9), np.int32)
    nearest[4, 4] = -1
    nearest[4, 5] = 1
    probabilities = np.zeros((9, 9, 16), np.float32)
    probabilities[..., 1], probabilities[4, 4, 3] = 1.0, 1.0
    probabilities[4, 5] = np.eye(16, dtype=np.float32)[14]
    cell = np.full(3, 4 * 9 + 4, np.int32)
    distance = np.array([20.0, 5.0, 12.0], np.float32)
    rows, said = rows_by_neighbors(probabilities, nearest, cell, distance, C)
    # Of 20 m as the wall around, of 5 m as the pole beside; of 12 m nothing stands near.
    assert said.tolist() == [True, True, False]
    assert rows[:2, :C].argmax(axis=1).tolist() == [1, 14]
    assert not rows[2, :C].any()


def test_the_classes_of_a_wall_do_not_bleed_onto_the_pole_before_it() -> None:
    nearest = np.zeros((9, 9), np.int32)
    nearest[:, 4] = 1
    probabilities = np.zeros((9, 9, 16), np.float32)
    probabilities[..., 1] = 1.0
    probabilities[:, 4, 1], probabilities[:, 4, 14] = 0.0, 1.0
    cell = np.full(2, 4 * 9 + 4, np.int32)
    distance = np.array([20.0, 5.0], np.float32)
    rows, _ = rows_by_neighbors(probabilities, nearest, cell, distance, C)
    assert rows[:, :C].argmax(axis=1).tolist() == [1, 14]


@pytest.mark.slow
def test_10_000_degenerate_scans_give_no_exception_and_no_nan() -> None:
    rng = np.random.default_rng(11)
    scores = rng.normal(0, 2, (8, 16, 16)).astype(np.float32)
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
        planes = fill_channels(points, points[:, 0].copy(), nearest, MEAN, STD)
        assert np.isfinite(planes).all()
        assert np.isfinite(distance).all()
        for rows, said in (
            rows_by_cell(scores, nearest, cell, distance, C),
            rows_by_neighbors(probabilities, nearest, cell, distance, C),
        ):
            assert np.isfinite(rows).all()
            assert (said == (cell >= 0)).all()
