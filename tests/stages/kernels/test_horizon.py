"""The kernels of the map with a horizon, one by one, against NumPy in float64."""

from __future__ import annotations

import numpy as np

from stages.kernels.geometry import rotation_exp
from stages.kernels.horizon import (
    ENTRY,
    MAX_POINTS,
    UNITS,
    add_entries,
    as_entries,
    find,
    fold,
    fold_positions,
    insert,
    merge_scan,
    push_entries,
    read_window,
    voxel_keys,
)
from stages.kernels.probability import softmax
from stages.kernels.voxels import FLOOR, REACH, index_keys, unpack

C = 15


def merged(
    points: np.ndarray, log_scores: np.ndarray, mean: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    x, y, z = np.ascontiguousarray(points.astype(np.float32).T)
    keys, inside = voxel_keys(x, y, z, np.ones(len(points), bool), np.eye(4), 0.25)
    return merge_scan(keys, inside, log_scores, C, mean)


def test_a_point_s_voxel_is_the_floor_of_its_place_in_the_map() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(0, 30, (1_000, 3)).astype(np.float32)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_exp(np.array([0.3, -0.2, 2.0])), (-500, 80, 3)
    evidence = rng.random(1_000) < 0.9
    keys, inside = voxel_keys(*np.ascontiguousarray(points.T), evidence, pose, 0.25)
    assert (keys[~evidence] == -1).all()
    place = (points.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]) / 0.25
    np.testing.assert_array_equal(unpack(keys[evidence]), np.floor(place[evidence]))
    np.testing.assert_allclose(inside, place - np.floor(place), atol=1e-6)


def test_points_out_of_the_map_s_reach_are_marked() -> None:
    far = np.array([[0.25 * REACH, 0, np.nan, np.inf], [0, 1, 0, 0], [0, 0, 0, 0]], np.float32)
    keys, inside = voxel_keys(*far, np.ones(4, bool), np.eye(4), 0.25)
    assert (keys == -2).tolist() == [True, False, True, True]
    assert np.isfinite(inside).all()


def test_the_points_of_a_scan_multiply_by_voxel() -> None:
    rng = np.random.default_rng(1)
    points = rng.random((5_000, 3)) * 1.5
    log_scores = rng.normal(0, 3, (5_000, 16)).astype(np.float32)
    log_scores[0, 3] = -np.inf  # a hard zero
    log_scores[1, 3] = np.nan
    log_scores[2] = np.nan
    voxels, rows, sums, counts = merged(points, log_scores)

    rows64 = log_scores[:, :C].astype(np.float64)
    top = np.nanmax(np.where(np.isnan(rows64), -np.inf, rows64), axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        floored = np.fmax(rows64 - top, np.log(1e-6))
    floored[2] = 0
    index = np.floor(points.astype(np.float32) / np.float32(0.25)).astype(int)
    order = {}
    for i, voxel in enumerate(map(tuple, index.tolist())):
        order.setdefault(voxel, []).append(i)
    assert list(map(tuple, unpack(voxels).tolist())) == list(order)
    assert counts.tolist() == [len(hits) for hits in order.values()]
    for v, hits in enumerate(order.values()):
        total = floored[hits].sum(axis=0)
        np.testing.assert_allclose(rows[v, :C], total - total.max(), atol=2e-4)
    place = points.astype(np.float32).astype(np.float64) / 0.25
    expected = [(place[hits] - index[hits]).sum(axis=0) for hits in order.values()]
    np.testing.assert_allclose(sums, expected, atol=1e-4)
    assert (rows[:, C:] == 0).all()

    _, means, _, _ = merged(points, log_scores, mean=True)
    np.testing.assert_allclose(means[:, :C], rows[:, :C] / counts[:, None], atol=1e-4)


def test_many_points_keep_the_small_difference_between_two_classes() -> None:
    n = 100_000
    log_scores = np.full((n, 16), -9, np.float32)
    log_scores[::2, 3], log_scores[1::2, 5] = 0, 0
    log_scores[0, 5] = -8.5
    _, rows, _, counts = merged(np.zeros((n, 3)), log_scores)
    assert rows[0, 5] == 0
    assert abs(rows[0, 3] + 0.5) < 1e-3
    assert counts[0] == MAX_POINTS


def test_voxels_are_found_again_and_new_ones_take_the_next_slots() -> None:
    rng = np.random.default_rng(0)
    voxels = rng.choice(2**62, 3_000, replace=False)
    table, keys = np.zeros(8_192, np.int32), np.empty(4_000, np.int64)
    slots, missing = find(voxels[:2_000], table, keys)
    assert missing == 2_000
    used = insert(voxels[:2_000], slots, 0, table, keys)
    assert slots.tolist() == list(range(2_000))
    slots, missing = find(voxels[::-1].copy(), table, keys)
    assert missing == 1_000
    assert slots[:1_000].tolist() == [-1] * 1_000
    assert slots[1_000:].tolist() == list(range(1_999, -1, -1))
    again = np.zeros_like(table)
    index_keys(keys, used, again)
    np.testing.assert_array_equal(find(voxels, again, keys)[0], find(voxels, table, keys)[0])


def test_folding_is_eq_13_to_17() -> None:
    rng = np.random.default_rng(3)
    scores, posterior = np.zeros((6, 16), np.float32), np.full((6, C), -np.log(C))
    for _ in range(12):
        slots = rng.permutation(6)[:4].astype(np.int32)
        rows = rng.normal(0, 2, (4, 16)).astype(np.float32)
        fold(slots, rows, scores, C)
        summed = posterior[slots] + rows[:, :C]
        posterior[slots] = summed - np.logaddexp.reduce(summed, axis=1, keepdims=True)
    assert np.abs(softmax(scores, C) - np.exp(posterior)).max() < 1e-5
    assert (scores[:, :C].max(axis=1) == 0).all()
    assert (scores[:, C:] == 0).all()


def test_a_running_mean_does_not_drift() -> None:
    means, hits = np.zeros((1, 3), np.float32), np.zeros(1, np.int32)
    slot, sums = np.zeros(1, np.int32), np.array([[1.2, 4.8, 9.6]], np.float32)
    for _ in range(100_000):
        fold_positions(slot, sums, np.array([12], np.int32), means, hits)
    np.testing.assert_allclose(means[0], (0.1, 0.4, 0.8), atol=2e-5)
    assert hits[0] == 1_200_000
    hits[0] = 2**31 - 5
    fold_positions(slot, sums, np.array([12], np.int32), means, hits)
    assert hits[0] == 2**31 - 1


def entries_of(rng: np.random.Generator, count: int) -> np.ndarray:
    rows = -rng.exponential(300, (count, 16)).astype(np.float32)
    sums = (rng.random((count, 3)) * 100).astype(np.float32)
    return as_entries(rows, sums, rng.integers(1, 300, count).astype(np.int32))


def test_entries_are_whole_numbers_of_1024ths_and_bounded() -> None:
    rows = np.array([[-0.5, -1e9] + [0] * 14], np.float32)
    entry = as_entries(rows, np.array([[1.5, 0, 2]], np.float32), np.array([3], np.int32))[0]
    assert entry[:3].tolist() == [-512, -(2**26), 0]
    assert entry[16:].tolist() == [1_536, 0, 2_048, 3]


def test_what_was_added_comes_out_without_a_trace() -> None:
    rng = np.random.default_rng(5)
    window = np.zeros((10, ENTRY), np.int32)
    scans = [(rng.permutation(10)[:6].astype(np.int32), entries_of(rng, 6)) for _ in range(31)]
    for slots, entries in scans:
        slots[0] = -1  # forgotten
        add_entries(slots, entries, 1, window)
    for slots, entries in scans[:-1]:
        add_entries(slots, entries, -1, window)
    expected = np.zeros_like(window)
    expected[scans[-1][0][1:]] = scans[-1][1][1:]
    np.testing.assert_array_equal(window, expected)


def test_a_ring_holds_a_voxel_s_last_entries_and_hands_out_the_oldest() -> None:
    rng = np.random.default_rng(6)
    ring = np.empty((3, 4, ENTRY), np.int32)
    pushed, window = np.zeros(3, np.int32), np.zeros((3, ENTRY), np.int32)
    history: list[list[np.ndarray]] = [[], [], []]
    for _ in range(40):
        slots = rng.permutation(3)[: int(rng.integers(1, 4))].astype(np.int32)
        entries = entries_of(rng, len(slots))
        left = push_entries(slots, entries, ring, pushed, window)
        for slot, entry, out in zip(slots, entries, left, strict=True):
            history[slot].append(entry)
            expected = history[slot][-5] if len(history[slot]) > 4 else np.zeros(ENTRY)
            np.testing.assert_array_equal(out, expected)
    for slot in range(3):
        np.testing.assert_array_equal(window[slot], np.sum(history[slot][-4:], axis=0))


def test_reading_a_window_gives_sound_log_scores() -> None:
    window = np.zeros((2, ENTRY), np.int32)
    window[0, :3] = -(2**30), -(2**30) - 512, -(2**31)
    forever = np.zeros((2, 16), np.float32)
    forever[0, 1] = 2.0
    alone = read_window(window, np.zeros((0, 16), np.float32), C)
    np.testing.assert_allclose(alone[0, 3:C], 0)
    window[0, 3:C] = -(2**31)
    assert read_window(window, np.zeros((0, 16), np.float32), C)[0, :3].tolist() == [
        0,
        -512 / UNITS,
        FLOOR,
    ]
    assert read_window(window, forever, C)[0, :2].tolist() == [-1.5, 0]
    assert (alone[1, :C] == 0).all()
    assert (alone[:, C:] == -1e4).all()
