"""The voxel kernel against eq 8-17 written out in float64 over a dictionary."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.kernels.geometry import rotation_exp
from stages.kernels.probability import softmax
from stages.kernels.voxels import FLOOR, REACH, integrate, rehash, unpack

C = 15


@dataclass
class Grid:
    """The arrays of a map, small enough to fill up."""

    voxels: int = 1 << 14
    used: int = 0
    beyond: int = 0
    table: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.table = np.zeros(2 * self.voxels, np.int32)
        self.keys = np.empty(self.voxels, np.int64)
        self.scores = np.empty((self.voxels, 16), np.float32)
        self.means = np.empty((self.voxels, 3), np.float32)
        self.counts = np.empty(self.voxels, np.int32)

    def add(
        self,
        points: np.ndarray,
        log_scores: np.ndarray,
        pose: np.ndarray,
        evidence: np.ndarray | None = None,
        voxel_m: float = 0.25,
    ) -> int:
        said = np.ones(len(points), bool) if evidence is None else evidence
        state = (self.table, self.keys, self.scores, self.means, self.counts, self.used, 0)
        self.used, reached, beyond = integrate(
            points.astype(np.float32), log_scores, said, pose, voxel_m, C, *state
        )
        self.beyond += beyond
        return reached


def scans(count: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(7)
    result = []
    for number in range(count):
        points = (rng.random((3_000, 3)) * (6, 6, 2) - 3).astype(np.float32)
        log_scores = rng.normal(scale=2.0, size=(3_000, 16)).astype(np.float32)
        pose = np.eye(4)
        pose[:3, :3] = rotation_exp(np.array([0.0, 0.02, 0.05]) * number)
        pose[:3, 3] = (-1_000 + 0.3 * number, 2_000, 5)
        result.append((points, log_scores, pose))
    return result


def test_the_deferred_map_is_eq_8_to_17() -> None:
    grid = Grid()
    posterior: dict[tuple[int, ...], np.ndarray] = {}
    seen: dict[tuple[int, ...], list[np.ndarray]] = {}
    for points, log_scores, pose in scans(6):
        assert grid.add(points, log_scores, pose) == len(points)
        for point, row in zip(points.astype(np.float64), log_scores, strict=True):
            position = pose[:3, :3] @ point + pose[:3, 3]
            index = tuple(int(i) for i in np.floor(position / 0.25))
            row = row[:C].astype(np.float64)
            floored = np.maximum(row - row.max(), np.log(1e-6))
            summed = posterior.get(index, np.full(C, -np.log(C))) + floored
            posterior[index] = summed - np.logaddexp.reduce(summed)  # eq 13-17
            seen.setdefault(index, []).append(position)

    indices = unpack(grid.keys[: grid.used])
    assert [tuple(i) for i in indices.tolist()] == list(posterior), "slots follow the first hit"
    expected = np.exp(np.array(list(posterior.values())))
    found = softmax(grid.scores[: grid.used], C)
    assert np.abs(found - expected).max() < 1e-5  # seen: 1e-6
    assert grid.scores[: grid.used, :C].max(axis=1).tolist() == [0.0] * grid.used
    assert grid.counts[: grid.used].tolist() == [len(hits) for hits in seen.values()]
    means = np.array([np.mean(hits, axis=0) for hits in seen.values()])
    assert np.abs(indices * 0.25 + grid.means[: grid.used] - means).max() < 1e-6


def test_the_mean_position_does_not_drift_over_a_million_points() -> None:
    grid = Grid(voxels=4)
    points = np.tile(np.array([[0.01, 0.12, 0.24], [0.03, 0.10, 0.22]]), (500_000, 1))
    grid.add(points, np.zeros((len(points), 16), np.float32), np.eye(4))
    np.testing.assert_allclose(grid.means[0], (0.02, 0.11, 0.23), atol=2e-5)


def test_a_class_that_lost_for_long_can_come_back() -> None:
    grid = Grid(voxels=4)
    points = np.zeros((1_000, 3))
    car, road = np.zeros((1_000, 16), np.float32), np.zeros((1_000, 16), np.float32)
    car[:, 13], road[:, 3] = 3.0, 3.0
    grid.add(points, car, np.eye(4))
    assert grid.scores[0, 3] == FLOOR
    grid.add(points[:21], road[:21], np.eye(4))
    assert grid.scores[0, :C].argmax() == 3


def test_points_without_evidence_leave_no_trace() -> None:
    grid = Grid()
    points, log_scores, pose = scans(1)[0]
    points[::2] = np.nan
    grid.add(points, log_scores, pose, evidence=np.arange(len(points)) % 2 == 1)
    other = Grid()
    other.add(points[1::2], log_scores[1::2], pose)
    assert grid.used == other.used
    np.testing.assert_array_equal(grid.scores[: grid.used], other.scores[: other.used])


def test_a_full_map_stops_at_the_point_that_did_not_fit_and_goes_on_after_growing() -> None:
    points, log_scores, pose = scans(1)[0]
    small, large = Grid(voxels=64), Grid()
    reached = small.add(points, log_scores, pose)
    large.add(points, log_scores, pose)
    assert small.used == 64
    assert 64 <= reached < len(points)

    grown = Grid()
    for name in ("keys", "scores", "means", "counts"):
        getattr(grown, name)[:64] = getattr(small, name)
    grown.used = 64
    rehash(grown.keys, 64, grown.table)
    grown.add(points[reached:], log_scores[reached:], pose)
    assert grown.used == large.used
    for name in ("keys", "scores", "means", "counts"):
        np.testing.assert_array_equal(
            getattr(grown, name)[: grown.used], getattr(large, name)[: large.used]
        )


def test_points_out_of_reach_are_counted() -> None:
    grid = Grid()
    far = np.array([[0.25 * REACH + 1, 0, 0], [0, 0, 0], [0, -np.inf, 0], [0, 0, np.nan]])
    grid.add(far, np.zeros((4, 16), np.float32), np.eye(4))
    assert (grid.used, grid.beyond) == (1, 3)


@settings(deadline=None)  # the first example compiles
@given(st.tuples(*[st.integers(-REACH + 1, REACH - 2)] * 3))
def test_a_key_unpacks_to_its_voxel(index: tuple[int, int, int]) -> None:
    grid = Grid(voxels=2)
    pose = np.eye(4)
    pose[:3, 3] = np.array(index) + 0.5
    grid.add(np.zeros((1, 3)), np.zeros((1, 16), np.float32), pose, voxel_m=1.0)
    assert tuple(unpack(grid.keys[:1])[0]) == index
