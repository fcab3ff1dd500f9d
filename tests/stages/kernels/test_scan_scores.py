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
    probabilities: np.ndarray, stands: np.ndarray, cell: int, point: np.ndarray
) -> np.ndarray:
    """The five cells nearest in space, by their distance, in float64; columns go around. `stands`
    (rows, columns, 3) are the points of the cells, NaN where there is none."""
    rows, columns = stands.shape[:2]
    around = range(-2, 3)
    cells = [
        (cell // columns + dv, (cell % columns + du) % columns) for dv in around for du in around
    ]
    gaps = [(float(np.linalg.norm(stands[c] - point)), c) for c in cells if 0 <= c[0] < rows]
    near = sorted(entry for entry in gaps if entry[0] <= 1.0)[:5]
    near = near or [(0.0, (cell // columns, cell % columns))]
    weights = [1 / (gap + 0.01 * float(np.linalg.norm(point))) for gap, _ in near]
    return np.average([probabilities[c] for _, c in near], axis=0, weights=weights)


def test_the_neighbors_of_a_point_are_those_nearest_in_space_and_the_nearer_counts_more() -> None:
    points = organized(seed=5)
    size = (64, 512)
    nearest, cell, distance = project_scan(points, size, UP_DOWN)
    stands = np.where((nearest >= 0)[..., None], points[nearest], np.nan).astype(np.float64)
    probabilities = np.zeros((*size, 16), np.float32)
    probabilities[..., :C] = softmax(scored(size), C)
    rows, said = rows_by_neighbors(probabilities, nearest, cell, distance, points, C)
    np.testing.assert_array_equal(said, cell >= 0)
    found = np.exp(rows[:, :C])
    assert np.abs(found[said].sum(axis=1) - 1).max() < 1e-4
    rng = np.random.default_rng(0)
    chosen = rng.choice(np.flatnonzero(said), 1_000)
    by_hand = [neighbors_by_hand(probabilities, stands, cell[i], points[i])[:C] for i in chosen]
    errors = np.abs(np.array(by_hand) - found[chosen]).max(axis=1)
    # Two gaps closer than 2e-6 of themselves may change places.
    assert np.quantile(errors, 0.995) < 1e-5


def wall_and_pole(pole: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cells (9, 9) of a wall of class 1 at 20 m and, in those given, of a pole of class 14 at 5 m:
    the point of each cell, the points, the probabilities."""
    nearest = np.arange(81, dtype=np.int32).reshape(9, 9)
    r = np.where(pole, 5.0, 20.0)
    azimuth, elevation = np.meshgrid(0.012 * np.arange(4, -5, -1), 0.025 * np.arange(4, -5, -1))
    points = r[..., None] * np.stack([np.ones((9, 9)), azimuth, elevation], axis=-1)
    probabilities = np.eye(16, dtype=np.float32)[np.where(pole, 14, 1)]
    return nearest, points.reshape(-1, 3).astype(np.float32), probabilities


def test_a_point_in_a_cell_without_a_return_is_told_by_those_near_it() -> None:
    pole = np.zeros((9, 9), bool)
    pole[4, 5] = True
    nearest, points, probabilities = wall_and_pole(pole)
    nearest[4, 4] = -1
    probabilities[4, 4] = np.eye(16, dtype=np.float32)[3]
    mine = points[40] / 20 * np.array([[20.0], [5.0], [12.0]], np.float32)
    everything = np.concatenate([points, mine])
    cell = np.concatenate([np.arange(81), np.full(3, 40)]).astype(np.int32)
    rows, said = rows_by_neighbors(probabilities, nearest, cell, ranges(everything), everything, C)
    # Of 20 m as the wall around, of 5 m as the pole beside; of 12 m nothing stands near.
    assert said[-3:].tolist() == [True, True, False]
    assert rows[-3:-1, :C].argmax(axis=1).tolist() == [1, 14]
    assert not rows[-1, :C].any()


def test_the_classes_of_a_wall_do_not_bleed_onto_the_pole_before_it() -> None:
    pole = np.zeros((9, 9), bool)
    pole[:, 4] = True
    nearest, points, probabilities = wall_and_pole(pole)
    behind = 4 * points[40]  # what the pole's cell hides, but for another beam of it
    everything = np.concatenate([points, behind[None]])
    cell = np.append(np.arange(81), 40).astype(np.int32)
    rows, _ = rows_by_neighbors(probabilities, nearest, cell, ranges(everything), everything, C)
    assert rows[[40, 81], :C].argmax(axis=1).tolist() == [14, 1]


def test_feet_are_not_the_street_at_the_same_range() -> None:
    """A point of a foot, between cells of the leg above and of the street beside it."""
    nearest = np.full((1, 9), -1, np.int32)
    nearest[0, 3:6] = np.arange(3)
    points = np.array(
        [[8.0, 0.3, -4.9], [8.0, 0.0, -4.7], [7.96, -0.6, -5.0], [8.0, 0.02, -4.8]], np.float32
    )
    probabilities = np.eye(16, dtype=np.float32)[[[3, 3, 3, 3, 6, 3, 3, 3, 3]]]
    cell = np.array([3, 4, 5, 4], np.int32)
    rows, _ = rows_by_neighbors(probabilities, nearest, cell, ranges(points), points, C)
    assert rows[3, :C].argmax() == 6


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
            rows_by_neighbors(probabilities, nearest, cell, distance, points, C),
        ):
            assert np.isfinite(rows).all()
            assert (said == (cell >= 0)).all()
