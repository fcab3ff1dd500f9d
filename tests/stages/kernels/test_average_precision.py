from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from stages.kernels.average_precision import (
    FrameHits,
    average_precision,
    bootstrap_interval,
    match,
    recall_at,
)

NONE = np.zeros((0, 4), np.float32)


def boxes(*rows: tuple[float, float, float, float]) -> NDArray[np.float32]:
    return np.array(rows, np.float32).reshape(-1, 4)


def frame(scores: list[float], hits: list[bool], objects: int) -> FrameHits:
    order = np.argsort(-np.array(scores, np.float32), kind="stable")
    found = np.array(hits, np.bool_)[order] if scores else np.zeros(0, np.bool_)
    return FrameHits(np.array(scores, np.float32)[order], found, objects)


def area_under_the_curve(frames: list[FrameHits]) -> float:
    """The definition: for each recall reached, the best precision there or beyond."""
    ranked = sorted(
        ((float(s), bool(h)) for one in frames for s, h in zip(one.scores, one.hits, strict=True)),
        key=lambda pair: -pair[0],
    )
    objects = sum(one.objects for one in frames)
    points = []
    for count in range(1, len(ranked) + 1):
        found = sum(hit for _, hit in ranked[:count])
        points.append((found / objects, found / count))
    area, before = 0.0, 0.0
    for recall in sorted({recall for recall, _ in points}):
        best = max(precision for reached, precision in points if reached >= recall)
        area, before = area + (recall - before) * best, recall
    return area


#: Scores that differ, so that the order is one.
RANKED = st.lists(st.booleans(), max_size=12).flatmap(
    lambda hits: st.tuples(
        st.just(hits),
        st.lists(st.integers(1, 10_000), min_size=len(hits), max_size=len(hits), unique=True),
        st.integers(0, 4),
    )
)


@given(RANKED)
def test_the_area_is_that_of_the_definition(
    ranked: tuple[list[bool], list[int], int],
) -> None:
    hits, scores, missed = ranked
    objects = sum(hits) + missed
    if not objects:
        return
    half = len(hits) // 2
    values = [score / 10_001 for score in scores]
    frames = [
        frame(values[:half], hits[:half], sum(hits[:half])),
        frame(values[half:], hits[half:], objects - sum(hits[:half])),
    ]
    assert average_precision(frames) == pytest.approx(area_under_the_curve(frames))


def test_a_better_box_takes_the_object_and_the_second_is_a_mistake() -> None:
    found = boxes((0, 0, 10, 10), (1, 0, 11, 10))
    hits = match(found, np.array([0.6, 0.9], np.float32), boxes((0, 0, 10, 10)), NONE)
    assert hits.scores.tolist() == pytest.approx([0.9, 0.6])
    assert hits.hits.tolist() == [True, False]


def test_a_box_takes_the_free_object_that_it_overlaps_most() -> None:
    objects = boxes((0, 0, 10, 10), (2, 0, 12, 10))
    found = boxes((2, 0, 12, 10), (1, 0, 11, 10))
    hits = match(found, np.array([0.9, 0.8], np.float32), objects, NONE)
    assert hits.hits.tolist() == [True, True]


def test_an_overlap_below_the_least_finds_nothing() -> None:
    found, objects = boxes((0, 0, 10, 10)), boxes((5, 0, 15, 10))
    assert match(found, np.ones(1, np.float32), objects, NONE, 0.34).hits.tolist() == [False]
    assert match(found, np.ones(1, np.float32), objects, NONE, 0.33).hits.tolist() == [True]


def test_a_mistake_in_an_ignored_region_counts_neither_way() -> None:
    found = boxes((0, 0, 10, 10), (20, 20, 30, 30))
    hits = match(found, np.array([0.9, 0.8], np.float32), NONE, boxes((0, 5, 40, 15)))
    assert hits.scores.tolist() == pytest.approx([0.8])
    assert hits.hits.tolist() == [False]


def test_an_object_found_beside_an_ignored_region_still_counts() -> None:
    box = boxes((0, 0, 10, 10))
    assert match(box, np.ones(1, np.float32), box, boxes((0, 0, 50, 50))).hits.tolist() == [True]


def test_without_objects_there_is_no_figure() -> None:
    frames = [frame([0.5], [False], 0)]
    assert np.isnan(average_precision(frames))
    assert np.isnan(bootstrap_interval(frames, rounds=5)).all()


def test_objects_without_detections_have_a_precision_of_zero() -> None:
    assert average_precision([frame([], [], 3)]) == 0


def test_the_interval_holds_the_figure_and_narrows_with_more_frames() -> None:
    mixed = [frame([0.9], [True], 1), frame([0.8], [False], 1)]
    few, many = bootstrap_interval(mixed * 4), bootstrap_interval(mixed * 40)
    assert few[0] < average_precision(mixed * 4) < few[1]
    assert many[1] - many[0] < few[1] - few[0]


def test_recall_and_precision_are_those_from_the_score_on() -> None:
    frames = [frame([0.9, 0.6, 0.3], [True, False, True], 4)]
    assert recall_at(frames, 0.5) == pytest.approx((0.25, 0.5))
    assert recall_at(frames, 0.1) == pytest.approx((0.5, 2 / 3))
