"""The cluster of eq 5 against brute force, and what boxes do to points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.kernels.foreground import (
    Claim,
    apply_claims,
    cluster,
    cluster_organized,
    near_depth,
    points_in_box,
    reach_m,
    seed,
)
from stages.kernels.probability import softmax, uniform_rows

C = 15
PERSON, ROAD, BUILDING = 5, 3, 1
PITCH = np.pi / 2 / 128


def by_brute_force(points: np.ndarray, rows: np.ndarray, first: int, tau: float) -> np.ndarray:
    """Grow until nothing changes, over all pairs, in float64."""
    p = points[rows].astype(np.float64)
    member = np.zeros(len(rows), bool)
    member[first] = True
    while True:
        gaps = ((p[:, None] - p[None, member]) ** 2).sum(axis=-1)
        with np.errstate(invalid="ignore"):
            grown = member | (gaps <= tau * tau).any(axis=1)
        if (grown == member).all():
            return member
        member = grown


def person_and_wall(rows: int = 128, columns: int = 1024, jitter: float = 0.0) -> np.ndarray:
    """An organized scan: a person at 6 m, one at 14 m, a rough wall at 15 m around it all."""
    rng = np.random.default_rng(2)
    v, u = np.arange(rows)[:, None] + 0.5, np.arange(columns) + 0.5
    elevation = np.pi / 4 - (v + rng.uniform(-jitter, jitter, (rows, columns))) * np.pi / 2 / rows
    azimuth = np.pi - (u + rng.uniform(-jitter, jitter, (rows, columns))) * 2 * np.pi / columns
    r = 15 + rng.normal(0, 0.15, (rows, columns))
    r[(abs(elevation) < 0.3) & (abs(azimuth) < 0.08)] = 6
    r[(abs(elevation) < 0.12) & (abs(azimuth - 0.2) < 0.04)] = 14
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    directions = np.stack([x, y, np.broadcast_to(np.sin(elevation), r.shape)], axis=-1)
    noise = rng.normal(0, 0.02, r.shape)
    return (directions * (r + noise)[..., None]).reshape(-1, 3).astype(np.float32)


def window(points: np.ndarray, azimuth: float, elevation: float) -> np.ndarray:
    """The points of a box around straight ahead."""
    a = np.arctan2(points[:, 1], points[:, 0])
    e = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    return np.flatnonzero((abs(a) < azimuth) & (abs(e) < elevation))


def test_points_in_a_box_include_its_edges() -> None:
    pixel = np.array([[0, 0], [10, 5], [20, 10], [20.1, 10], [15, 4.9]], np.float32)
    assert points_in_box(pixel, np.array([10, 5, 20, 10], np.float32)).tolist() == [1, 2]


def test_what_is_near_in_depth_lies_around_the_25_percent_quantile_not_the_wall_behind() -> None:
    person, wall, stray = [8.0, 8.1, 8.2, 8.3], [15.0] * 6, [3.0]
    distance = np.array(wall + person + stray, np.float32)
    near = near_depth(distance, float(distance[seed(distance)]), 1.0)
    assert near.tolist() == [False] * 6 + [True] * 4 + [False]


def test_tau_is_1_5_times_the_beams_distance_at_the_seed() -> None:
    assert reach_m(5.0, PITCH) == pytest.approx(0.092, abs=5e-4)
    assert reach_m(20.0, PITCH) == pytest.approx(20 * 0.018408, rel=1e-4)


def test_the_seed_is_a_real_point_at_the_25_percent_quantile_and_ties_go_to_the_first() -> None:
    assert seed(np.array([9, 7, 8, 5, 6], np.float32)) == 4  # ranks 5 6 7 8 9: floor(4 / 4) = 1
    assert seed(np.array([9, 2, 2, 2], np.float32)) == 1
    assert seed(np.array([np.nan, 3, np.inf], np.float32)) == 1
    assert seed(np.array([np.nan], np.float32)) == -1
    assert seed(np.zeros(0, np.float32)) == -1


def test_the_cluster_is_the_person_without_the_wall_behind() -> None:
    points = person_and_wall()
    rows = window(points, 0.15, 0.4)
    distance = np.linalg.norm(points[rows], axis=1).astype(np.float32)
    first = seed(distance)
    member = cluster(points, rows, first, reach_m(float(distance[first]), PITCH))
    np.testing.assert_array_equal(member, distance < 7)
    np.testing.assert_array_equal(near_depth(distance, float(distance[first]), 1.0), member)


@pytest.mark.parametrize("jitter", [0.0, 0.5])
def test_hash_flood_fill_and_brute_force_agree(jitter: float) -> None:
    points = person_and_wall(64, 512, jitter)
    rng = np.random.default_rng(4)
    sizes = set()
    for azimuth, elevation in ((0.15, 0.4), (0.3, 0.3), (0.05, 0.7), (0.4, 0.1)):
        rows = window(points, azimuth, elevation)
        distance = np.linalg.norm(points[rows], axis=1).astype(np.float32)
        for first in (seed(distance), int(rng.integers(len(rows)))):
            for spread in (0.7, 1.5, 4.0, 40.0):
                tau = reach_m(float(distance[first]), 2 * PITCH, spread)
                expected = by_brute_force(points, rows, first, tau)
                np.testing.assert_array_equal(cluster(points, rows, first, tau), expected)
                flood = cluster_organized(points, rows, first, tau, 64, 512, 2 * PITCH)
                np.testing.assert_array_equal(flood, expected)
                sizes.add(int(expected.sum()))
    assert len(sizes) > 10


def test_a_cluster_goes_across_the_seam_of_the_scan() -> None:
    points = person_and_wall(64, 512)
    points[:, :2] *= -1  # the person stands behind now
    turned = points.reshape(64, 512, 3)[:, np.roll(np.arange(512), 256)].reshape(-1, 3).copy()
    rows = np.flatnonzero((turned[:, 0] < 0) & (abs(turned[:, 1]) < 1.5) & (abs(turned[:, 2]) < 2))
    first = seed(np.linalg.norm(turned[rows], axis=1).astype(np.float32))
    flood = cluster_organized(turned, rows, first, 0.3, 64, 512, 2 * PITCH)
    np.testing.assert_array_equal(flood, by_brute_force(turned, rows, first, 0.3))
    columns = rows[flood] % 512
    assert columns.min() < 10
    assert columns.max() > 500


@settings(deadline=None, max_examples=200)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.floats(0.01, 3.0))
def test_any_points_cluster_as_by_brute_force(number: int, count: int, tau: float) -> None:
    rng = np.random.default_rng(number)
    # On a coarse grid many distances are equal and some are exactly tau.
    points = (rng.integers(-6, 7, (count, 3)) * rng.choice([tau, 0.5, 0.1])).astype(np.float32)
    rows = np.sort(rng.choice(count, int(rng.integers(1, count + 1)), replace=False))
    first = int(rng.integers(len(rows)))
    expected = by_brute_force(points, rows, first, tau)
    np.testing.assert_array_equal(cluster(points, rows, first, tau), expected)


def test_two_points_are_one_cluster_only_within_tau() -> None:
    points = np.array([[5, 0, 0], [5.05, 0, 0], [9, 0, 0]], np.float32)
    assert cluster(points, np.array([0, 1]), 0, 0.09).tolist() == [True, True]
    assert cluster(points, np.array([0, 2]), 1, 0.09).tolist() == [False, True]
    assert cluster(points, np.array([2]), 0, 0.09).tolist() == [True]
    assert cluster(points, np.zeros(0, np.int64), -1, 0.09).tolist() == []


def claim(index: list[int], member: list[bool], label: int, **changes: float) -> Claim:
    """A box 20 x 20 whose points all lie in its middle."""
    return Claim(
        np.array(index),
        np.full((len(index), 2), 10, np.float32),
        np.array(member),
        np.array([0, 0, 20, 20], np.float32),
        label,
        float(changes.get("score", 0.8)),
        int(changes.get("source", 8)),
    )


def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Four points whose image says person; the LiDAR said building of the first two, of the rest
    nothing."""
    prior, voted = uniform_rows(4, C), np.array([1, 1, 0, 0], np.uint32)
    prior[:2, BUILDING] = 2.0
    total = prior.copy()
    total[:, PERSON] += 5.0
    return total, voted | np.uint32(2), prior, voted


def test_what_stands_behind_the_person_returns_to_what_the_lidar_said() -> None:
    total, voted, prior, prior_voted = scene()
    members = [True, False, True, False]
    apply_claims([claim([0, 1, 2, 3], members, PERSON)], total, voted, prior, prior_voted, C)
    np.testing.assert_array_equal(total[[1, 3]], prior[[1, 3]])
    assert voted.tolist() == [1 | 2 | 8, 1, 2 | 8, 0]  # the last is unlabeled again
    p = softmax(scene()[0][0], C).astype(np.float64)
    weights = np.full(C, 0.2 / (C - 1))
    weights[PERSON] = 0.8  # eq 4 in the box's middle
    np.testing.assert_allclose(softmax(total[0], C), p * weights / (p * weights).sum(), rtol=1e-4)


def test_a_point_of_another_class_is_not_reset() -> None:
    total, voted, prior, prior_voted = scene()
    total[1, ROAD] += 20.0
    before = total[1].copy()
    apply_claims([claim([0, 1], [True, False], PERSON)], total, voted, prior, prior_voted, C)
    np.testing.assert_array_equal(total[1], before)


@pytest.mark.parametrize("order", [1, -1])
def test_overlapping_boxes_do_not_undo_each_other(order: int) -> None:
    claims = [
        claim([0, 1, 2], [True, False, False], PERSON, score=0.9),
        claim([0, 1, 2], [False, True, False], PERSON, score=0.6),
    ][::order]
    total, voted, prior, prior_voted = scene()
    apply_claims(claims, total, voted, prior, prior_voted, C)
    assert softmax(total, C).argmax(axis=1)[:2].tolist() == [PERSON, PERSON]
    assert voted.tolist() == [11, 11, 0, 2]


def test_one_detector_counts_once_and_two_cameras_twice() -> None:
    def person(*sources: tuple[int, float]) -> float:
        total, voted, prior, prior_voted = scene()
        boxes = [claim([0], [True], PERSON, score=score, source=bit) for bit, score in sources]
        apply_claims(boxes, total, voted, prior, prior_voted, C)
        return float(total[0, PERSON])

    assert person((8, 0.8), (8, 0.6)) == person((8, 0.8)) == person((8, 0.6), (8, 0.8))
    once, twice = person((8, 0.8)), person((8, 0.8), (16, 0.8))
    assert twice - once == pytest.approx(np.log((C - 1) * 0.8 / 0.2), rel=1e-5)


def test_fewer_points_are_wrong_with_clusters_than_with_boxes_or_a_depth_threshold() -> None:
    """Fig 4: an object that leans away 2 m in depth before a wall 0.7 m behind it."""
    rng = np.random.default_rng(0)
    u, v = np.meshgrid(np.linspace(-1, 1, 60), np.linspace(-1, 1, 60))
    truth = abs(u) + abs(v) < 0.8
    depth = np.where(truth, 8 + 2 * u, 11.5) + rng.normal(0, 0.01, u.shape)
    points = np.stack([depth, u, v], axis=-1).reshape(-1, 3).astype(np.float32)
    rows, distance = np.arange(3_600), np.linalg.norm(points, axis=1)
    first = seed(distance)
    tau = reach_m(float(distance[first]), PITCH)
    wrong = {
        "box": int((~truth).sum()),
        "depth": int((near_depth(distance, float(distance[first]), 0.8) != truth.ravel()).sum()),
        "cluster": int((cluster(points, rows, first, tau) != truth.ravel()).sum()),
    }
    assert wrong["cluster"] == 0, wrong
    assert wrong["cluster"] < wrong["depth"] < wrong["box"]


@pytest.mark.slow
def test_10_000_degenerate_boxes_give_no_exception_and_no_nan() -> None:
    rng = np.random.default_rng(7)
    for _ in range(10_000):
        n = int(rng.integers(1, 17))
        points = rng.normal(0, 10 ** rng.uniform(-3, 18), (n, 3)).astype(np.float32)
        points[rng.random((n, 3)) < 0.2] = rng.choice([np.nan, np.inf, -np.inf, 0, 1e38])
        if rng.random() < 0.2:
            points[:] = points[0]
        rows = np.flatnonzero(rng.random(n) < 0.7)
        with np.errstate(over="ignore"):
            distance = np.linalg.norm(points[rows], axis=1).astype(np.float32)
        first = seed(distance)
        if first < 0:
            continue
        tau = reach_m(float(distance[first]), PITCH)
        member = cluster(points, rows, first, tau)
        flood = cluster_organized(points, rows, first, tau, 1, n, PITCH)
        assert member[first]
        assert flood[first]
        total, prior = uniform_rows(n, C), uniform_rows(n, C)
        voted, prior_voted = np.zeros((2, n), np.uint32)
        pixel = rng.normal(5, 10, (len(rows), 2)).astype(np.float32)
        box = rng.choice([0, 5, 10, 10], 4).astype(np.float32)
        found = Claim(rows, pixel, member, box, int(rng.integers(C)), float(rng.random()), 1)
        apply_claims([found], total, voted, prior, prior_voted, C)
        assert np.isfinite(total).all()
