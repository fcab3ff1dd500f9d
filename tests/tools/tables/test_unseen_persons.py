"""Fig 12: recall of persons by where the cameras look."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch", reason="training needs the extra 'train'")

from judged_scans import PERSON, ROAD, Network, judged, row

from tools.propagation.pictures import MARK, range_panels
from tools.tables.unseen_persons import (
    IN_VIEW,
    NEVER,
    OUT_NOW,
    judge_persons,
    persons_never_in_view,
)
from tools.tables.world import JudgedScan

#: Three persons: 7 is in view in the second scan alone, 8 never, 9 always.
THINGS = [1, 7, 7, 8, 8, 9]
TRUTH = [ROAD, PERSON, PERSON, PERSON, PERSON, PERSON]


class World:
    """Two scans in place of flights."""

    def judged(self, _: str) -> Iterator[JudgedScan]:
        yield judged(TRUTH, [0, 5], {}, THINGS)
        yield judged(TRUTH, [0, 1, 2, 5], {}, THINGS)


def test_a_person_out_of_view_in_every_scan_is_never_in_view() -> None:
    assert persons_never_in_view(World(), "flight_a").tolist() == [8]  # type: ignore[arg-type]


def test_recall_is_told_apart_by_where_the_cameras_look() -> None:
    network = Network([ROAD, PERSON, PERSON, PERSON, ROAD, ROAD])  # and nothing of the last point
    verdict = judge_persons(World(), row(network="source"), network, "flight_a")  # type: ignore[arg-type]
    assert verdict.points == {IN_VIEW: 4, OUT_NOW: 2, NEVER: 4}
    assert verdict.classes[OUT_NOW] == 100
    assert verdict.classes[IN_VIEW] == 50  # person 9 is missed in both scans
    assert verdict.mean == 50
    assert (verdict.facts["persons"], verdict.facts["persons_never_in_view"]) == (3, 1)


def test_where_nobody_is_out_of_view_there_is_no_figure() -> None:
    class Seen(World):
        def judged(self, _: str) -> Iterator[JudgedScan]:
            for scan in World.judged(self, _):
                yield replace(scan, visible=np.ones(6, np.bool_))

    network = Network([PERSON] * 6)
    verdict = judge_persons(Seen(), row(network="source"), network, "flight_a")  # type: ignore[arg-type]
    assert np.isnan(verdict.mean)
    assert verdict.classes[OUT_NOW] is None


def test_a_box_is_around_the_marked_points_in_every_panel() -> None:
    azimuth = np.linspace(-3.1, 3.1, 400)
    ring = 8 * np.column_stack([np.cos(azimuth), np.sin(azimuth), np.full(400, -0.1)])
    scan = judged(TRUTH, [], {})
    observation = replace(
        scan.observation, points=ring.astype(np.float32), remission=None, shape=None
    )
    labels = np.full(400, ROAD, np.uint8)
    marked = [np.flatnonzero(np.abs(azimuth - 0.5) < 0.1)]
    plain = range_panels(observation, {"a": labels, "b": labels})
    boxed = range_panels(observation, {"a": labels, "b": labels}, marked)
    assert boxed.shape == plain.shape
    blue = (boxed == MARK).all(axis=2)
    assert not (plain == MARK).all(axis=2).any()
    columns = np.flatnonzero(blue.any(axis=0))
    assert np.ptp(columns) < 60  # of 1024: 0.2 rad
    rows_ = np.flatnonzero(blue.any(axis=1))
    assert np.count_nonzero(np.diff(rows_) > 20) == 2  # in the range and in both labelings
