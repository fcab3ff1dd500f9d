"""The map's horizons, against maps built from scratch; forgetting, saving, memory."""

from __future__ import annotations

import io
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import DataError
from stages import voxel_map
from stages.kernels.map_query import select
from stages.kernels.probability import softmax
from stages.kernels.voxels import FLOOR, REACH
from stages.types import Cloud, SemanticVoxels
from stages.voxel_map import VoxelMap

C = 15
SECOND = 1_000_000_000


def cloud(number: int, points: int = 1_500) -> Cloud:
    rng = np.random.default_rng(number)
    where = (rng.random((points, 3)) * (4, 4, 1)).astype(np.float32)
    log_scores = rng.normal(0, 2, (points, 16)).astype(np.float32)
    return Cloud(where, log_scores, rng.random(points) < 0.9, None, "lidar")


def pose(number: int) -> np.ndarray:
    result = np.eye(4)
    result[0, 3] = 0.4 * number
    return result


def built(numbers: range, **options: Any) -> VoxelMap:
    result = VoxelMap(voxel_m=0.25, classes=C, **options)
    for number in numbers:
        result.integrate(cloud(number), pose(number), number * SECOND)
    return result


def by_voxel(voxels: SemanticVoxels) -> dict[tuple[int, ...], tuple[Any, ...]]:
    columns = (voxels.counts, voxels.positions, voxels.log_scores)
    keys = map(tuple, voxels.indices.tolist())
    return dict(zip(keys, zip(*(c.tolist() for c in columns), strict=True), strict=True))


def eq_8_to_17(numbers: range) -> dict[tuple[int, ...], np.ndarray]:
    posterior: dict[tuple[int, ...], np.ndarray] = {}
    for number in numbers:
        payload = cloud(number)
        points = payload.points.astype(np.float64) + pose(number)[:3, 3]
        for i in np.flatnonzero(payload.evidence):
            voxel = tuple(np.floor(points[i] / 0.25).astype(int).tolist())
            row = payload.log_scores[i, :C].astype(np.float64)
            row = np.maximum(row - row.max(), np.log(1e-6))
            summed = posterior.get(voxel, np.full(C, -np.log(C))) + row
            posterior[voxel] = summed - np.logaddexp.reduce(summed)
    return posterior


def test_the_infinite_map_is_eq_8_to_17() -> None:
    expected = eq_8_to_17(range(6))
    voxels = built(range(6)).snapshot()
    assert list(map(tuple, voxels.indices.tolist())) == list(expected)
    found = softmax(voxels.log_scores, C)
    assert np.abs(found - np.exp(list(expected.values()))).max() < 1e-5


def test_voxels_follow_their_first_hit_with_counts_and_mean_positions() -> None:
    seen: dict[tuple[int, ...], list[np.ndarray]] = {}
    for number in range(6):
        payload = cloud(number)
        points = payload.points.astype(np.float64) + pose(number)[:3, 3]
        for position in points[payload.evidence]:
            seen.setdefault(tuple(np.floor(position / 0.25).astype(int).tolist()), []).append(
                position
            )
    voxels = built(range(6)).snapshot()
    assert [tuple(index) for index in voxels.indices.tolist()] == list(seen)
    assert voxels.counts.tolist() == [len(hits) for hits in seen.values()]
    assert voxels.log_scores[:, :C].max(axis=1).tolist() == [0.0] * len(seen)
    means = np.array([np.mean(hits, axis=0) for hits in seen.values()])
    assert np.abs(voxels.positions - means).max() < 1e-6


def test_a_class_that_lost_for_long_can_come_back() -> None:
    points = np.zeros((1_000, 3), np.float32)
    car, road = np.zeros((1_000, 16), np.float32), np.zeros((1_000, 16), np.float32)
    car[:, 13], road[:, 3] = 3.0, 3.0
    said = np.ones(1_000, bool)
    voxel_map = VoxelMap(voxel_m=0.25, classes=C)
    voxel_map.integrate(Cloud(points, car, said, None, ""), np.eye(4), 0)
    assert voxel_map.snapshot().log_scores[0, 3] == FLOOR
    voxel_map.integrate(Cloud(points[:21], road[:21], said[:21], None, ""), np.eye(4), 1)
    assert voxel_map.snapshot().log_scores[0, :C].argmax() == 3


def test_points_without_evidence_leave_no_trace() -> None:
    payload = cloud(0)
    points = payload.points.copy()
    points[::2] = np.nan
    odd = np.arange(len(points)) % 2 == 1
    some, only = (VoxelMap(voxel_m=0.25, classes=C) for _ in range(2))
    some.integrate(Cloud(points, payload.log_scores, odd, None, ""), pose(1), 0)
    only.integrate(Cloud(points[odd], payload.log_scores[odd], odd[odd], None, ""), pose(1), 0)
    assert by_voxel(some.snapshot()) == by_voxel(only.snapshot())


def test_points_out_of_reach_are_counted() -> None:
    far = np.array([[0.25 * REACH + 1, 0, 0], [0, 0, 0], [0, -np.inf, 0], [0, 0, np.nan]])
    voxel_map = VoxelMap(voxel_m=0.25, classes=C)
    nothing, said = np.zeros((4, 16), np.float32), np.ones(4, bool)
    voxel_map.integrate(Cloud(far.astype(np.float32), nothing, said, None, ""), np.eye(4), 0)
    assert (voxel_map.used, voxel_map.beyond) == (1, 3)


def test_the_window_map_is_the_map_of_the_last_scans_alone() -> None:
    slid = built(range(12), horizon="window-drop", scans=4).snapshot()
    fresh = built(range(8, 12), horizon="window-drop", scans=4).snapshot()
    assert by_voxel(slid) == by_voxel(fresh)
    exact = eq_8_to_17(range(8, 12))
    found = dict(zip(map(tuple, slid.indices.tolist()), softmax(slid.log_scores, C), strict=True))
    worst = max(float(np.abs(found[v] - np.exp(row)).max()) for v, row in exact.items())
    assert found.keys() == exact.keys()
    assert worst < 2e-3  # of 1/1024 nat


@settings(deadline=None, max_examples=15)
@given(st.integers(1, 5), st.integers(0, 9))
def test_any_window_is_the_map_of_its_scans(scans: int, count: int) -> None:
    slid = built(range(count), horizon="window-drop", scans=scans).snapshot()
    fresh = built(range(max(0, count - scans), count), horizon="window-drop", scans=scans)
    assert by_voxel(slid) == by_voxel(fresh.snapshot())


def test_a_window_per_voxel_is_the_map_of_the_scans_that_hit_it_last() -> None:
    found = by_voxel(built(range(12), horizon="window-drop", scans=3, window_of="voxel").snapshot())
    hits: dict[tuple[int, ...], list[int]] = {}
    single = [by_voxel(built(range(n, n + 1)).snapshot()) for n in range(12)]
    for number, voxels in enumerate(single):
        for voxel in voxels:
            hits.setdefault(voxel, []).append(number)
    assert found.keys() == hits.keys()
    for voxel, numbers in hits.items():
        count, _, scores = found[voxel]
        assert count == sum(single[n][voxel][0] for n in numbers[-3:])
        summed = np.sum([single[n][voxel][2][:C] for n in numbers[-3:]], axis=0)
        inside = summed - summed.max() > -45  # single maps are floored at -60
        difference = np.abs(np.array(scores[:C]) - (summed - summed.max()))[inside]
        assert difference.max() < 4e-3


@pytest.mark.parametrize("window_of", ["map", "voxel"])
def test_a_window_that_folds_into_infinity_loses_nothing(window_of: Any) -> None:
    options: dict[str, Any] = {"horizon": "window-then-infinite", "scans": 3}
    both = built(range(9), **options, window_of=window_of)
    forever = by_voxel(built(range(9)).snapshot())
    everything = by_voxel(both.snapshot())
    assert everything.keys() == forever.keys()
    for voxel, (count, position, scores) in forever.items():
        assert everything[voxel][0] == count
        np.testing.assert_allclose(everything[voxel][1], position, atol=1e-6)
        inside = np.array(scores) > -40  # the floor acts at other times
        np.testing.assert_allclose(
            np.array(everything[voxel][2])[inside], np.array(scores)[inside], atol=0.01
        )
    alone = built(range(9), horizon="window-drop", scans=3, window_of=window_of)
    assert by_voxel(both.snapshot(recent=True)) == by_voxel(alone.snapshot())


def test_a_scan_of_equal_points_counts_once_with_the_mean() -> None:
    one, many = cloud(0, 1), cloud(0, 1)
    hundred = Cloud(
        np.repeat(many.points, 100, 0),
        np.repeat(many.log_scores, 100, 0),
        np.ones(100, bool),
        None,
        "",
    )
    maps = []
    for payload in (Cloud(one.points, one.log_scores, np.ones(1, bool), None, ""), hundred):
        maps.append(VoxelMap(voxel_m=0.25, classes=C, merge="mean"))
        maps[-1].integrate(payload, np.eye(4), 0)
    single, averaged = (m.snapshot().log_scores for m in maps)
    np.testing.assert_allclose(averaged, single, atol=1e-4)


@pytest.mark.parametrize("horizon", ["infinite", "window-drop", "window-then-infinite"])
def test_a_map_that_outgrows_its_arrays_is_the_map_that_had_room(
    horizon: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    roomy = by_voxel(built(range(8), horizon=horizon, scans=3).snapshot())
    monkeypatch.setattr(voxel_map, "INITIAL_VOXELS", 16)
    grown = built(range(8), horizon=horizon, scans=3)
    assert by_voxel(grown.snapshot()) == roomy


def test_a_window_that_moved_on_holds_no_memory_of_where_it_was(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(voxel_map, "INITIAL_VOXELS", 16)
    slid = built(range(40), horizon="window-drop", scans=3)
    assert slid.used < 2.5 * len(slid.snapshot().counts)


def test_the_infinite_map_takes_at_most_140_bytes_per_voxel(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(voxel_map, "INITIAL_VOXELS", 1 << 10)
    growing = VoxelMap(voxel_m=0.25, classes=C)
    for number in range(120):
        growing.integrate(cloud(number), pose(5 * number), 0)
        if growing.used > 4_096:
            assert growing.nbytes / growing.used <= 140
    assert growing.used > 50_000


def test_old_and_far_voxels_are_forgotten_and_the_rest_is_untouched() -> None:
    for horizon in ("infinite", "window-drop", "window-then-infinite"):
        grown = built(range(12), horizon=horizon, scans=12)  # type: ignore[arg-type]
        before = by_voxel(grown.snapshot())
        assert grown.evict(11 * SECOND, max_age_s=100.0) == 0
        forgotten = grown.evict(
            11 * SECOND, max_age_s=4.5, center=np.array([4.0, 2.0, 0.5]), max_distance_m=3.0
        )
        after = by_voxel(grown.snapshot())
        assert 0 < len(after) == len(before) - forgotten
        assert all(before[voxel] == entry for voxel, entry in after.items())
        newest = {v for n in range(7, 12) for v in by_voxel(built(range(n, n + 1)).snapshot())}
        assert after.keys() <= newest
        centers = (np.array(list(after)) + 0.5) * 0.25
        assert np.linalg.norm(centers - (4.0, 2.0, 0.5), axis=1).max() <= 3.0
        grown.integrate(cloud(12), pose(12), 12 * SECOND)
        for number in range(13, 30):  # entries of forgotten voxels leave the queue unharmed
            grown.integrate(cloud(number), pose(number), number * SECOND)
        if horizon == "window-drop":
            fresh = built(range(18, 30), horizon="window-drop", scans=12)
            assert by_voxel(grown.snapshot()) == by_voxel(fresh.snapshot())


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"horizon": "window-drop", "scans": 3},
        {"horizon": "window-then-infinite", "scans": 3},
        {"horizon": "window-then-infinite", "scans": 3, "window_of": "voxel", "merge": "mean"},
    ],
)
def test_a_loaded_map_goes_on_where_the_saved_one_stood(options: dict[str, Any]) -> None:
    grown = built(range(6), **options)
    file = io.BytesIO()
    grown.save(file)
    file.seek(0)
    loaded = VoxelMap.load(file)
    for number in range(6, 10):
        for each in (grown, loaded):
            each.integrate(cloud(number), pose(number), number * SECOND)
    one, other = grown.snapshot(), loaded.snapshot()
    for field in fields(SemanticVoxels):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))
    assert loaded.evict(10 * SECOND, max_age_s=2.5) == grown.evict(10 * SECOND, max_age_s=2.5)


def test_a_file_that_is_no_map_is_refused() -> None:
    with pytest.raises(DataError, match="not a saved voxel map"):
        VoxelMap.load(io.BytesIO(b"ply\n"))
    file = io.BytesIO()
    np.savez(file, keys=np.zeros(3))
    file.seek(0)
    with pytest.raises(DataError, match="voxel_m"):
        VoxelMap.load(file)


def test_wrong_options_are_said() -> None:
    with pytest.raises(ValueError, match="voxel_m must be above 0"):
        VoxelMap(voxel_m=0, classes=C)
    with pytest.raises(ValueError, match="a horizon of 32 scans"):
        VoxelMap(voxel_m=1, classes=C, scans=32)
    with pytest.raises(ValueError, match="has no window"):
        VoxelMap(voxel_m=1, classes=C).snapshot(recent=True)


def test_queries_take_what_they_name() -> None:
    voxels = built(range(3)).snapshot()
    p = softmax(voxels.log_scores, C).astype(np.float64)
    label, sure = p.argmax(axis=1), p.max(axis=1)
    entropy = -(p * np.log(np.maximum(p, 1e-300))).sum(axis=1)

    def rows(**question: Any) -> list[int]:
        return select(voxels.positions, voxels.log_scores, C, **question).tolist()

    x = voxels.positions
    assert rows() == list(range(len(x)))
    box = ((1, 1, 0), (2, 3, 1))
    inside = (x >= box[0]).all(axis=1) & (x <= box[1]).all(axis=1)
    assert rows(box=box) == np.flatnonzero(inside).tolist()
    near = np.linalg.norm(x - (2.0, 2.0, 0.5), axis=1) <= 1
    assert rows(center=(2, 2, 0.5), radius_m=1.0) == np.flatnonzero(near).tolist()
    assert rows(labels=[3, 5]) == np.flatnonzero(np.isin(label, (3, 5))).tolist()
    assert rows(without=[5, 13]) == np.flatnonzero(~np.isin(label, (5, 13))).tolist()
    assert rows(min_confidence=0.9) == np.flatnonzero(sure >= 0.9).tolist()
    assert rows(max_entropy=0.1) == np.flatnonzero(entropy <= 0.1).tolist()
    both = np.flatnonzero(near & (label == 3) & (sure >= 0.5)).tolist()
    assert rows(center=(2, 2, 0.5), radius_m=1.0, labels=[3], min_confidence=0.5) == both


@pytest.mark.slow
@pytest.mark.parametrize("horizon", ["infinite", "window-drop", "window-then-infinite"])
def test_10_000_scans_leave_it_finite_and_able_to_learn(horizon: Any) -> None:
    """Degenerate ones among them; afterwards a new class wins within a few scans."""
    rng = np.random.default_rng(0)
    worn = VoxelMap(voxel_m=0.25, classes=C, horizon=horizon, scans=5)
    for number in range(10_000):
        n = int(rng.integers(0, 20))
        points = (rng.random((n, 3)) * 2).astype(np.float32)
        scores = rng.normal(0, 3, (n, 16)).astype(np.float32)
        scores[:, 13] += 4.0
        if number % 3 == 0:
            points[rng.random((n, 3)) < 0.1] = rng.choice([np.nan, np.inf, -np.inf, 1e30])
            scores[rng.random((n, 16)) < 0.2] = rng.choice([np.nan, np.inf, -np.inf, 3e38])
        worn.integrate(Cloud(points, scores, np.ones(n, bool), None, ""), np.eye(4), number)
        if number % 1_000 == 0:
            voxels = worn.snapshot()
            assert np.isfinite(voxels.log_scores).all()
            assert np.isfinite(voxels.positions).all()
    road = np.full((1, 16), -20, np.float32)
    road[0, 3] = 0
    here = Cloud(np.full((1, 3), 0.1, np.float32), road, np.ones(1, bool), None, "")
    for number in range(6):
        worn.integrate(here, np.eye(4), 10_000 + number)
    assert by_voxel(worn.snapshot())[0, 0, 0][2][3] == 0.0
