from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import nullcontext
from typing import Any

import pytest

from pipeline.clock import ManualClock
from pipeline.measuring.board import Board
from pipeline.measuring.statistics import Statistics
from pipeline.measuring.status import PERIOD_NS, WINDOW, Status
from pipeline.message import Message
from pipeline.scheduling.events import Output, Step
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Input, Port, StageNode, Topology

MS = 1_000_000
TOPOLOGY = Topology(
    (
        StageNode("camera"),
        StageNode("work", (Input("x", (Port("camera"),)),)),
        StageNode("sink", (Input("x", (Port("work"),)),), outputs=()),
    )
)


class Pages(Board):
    """A board in memory."""

    def __init__(self) -> None:
        self.pages: list[Mapping[str, Any]] = []

    def write(self, page: Mapping[str, Any]) -> None:
        self.pages.append(page)


class Case:
    """A graph on a clock that stands where the test puts it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock = ManualClock(1)
        self.cpu_ns = 0
        monkeypatch.setattr(time, "monotonic_ns", self.clock.now)
        monkeypatch.setattr(time, "process_time_ns", lambda: self.cpu_ns)
        self.board = Pages()
        self.statistics = Statistics(offline=False)
        self.scheduler = Scheduler(TOPOLOGY, observer=self.statistics)
        self.status = Status(self.board, "uav", TOPOLOGY, self.scheduler, self.statistics)

    def begin(self) -> None:
        self.status.begin(1.0, self.clock, nullcontext)

    def frame(self, at_ms: int, took_ms: int = 0) -> None:
        """A frame stamped 20 ms before it comes at `at_ms`; the stage and the sink take it."""
        self.clock.advance_to(at_ms * MS)
        message = Message.at((at_ms - 20) * MS, at_ms)
        starts = self.scheduler.publish(Port("camera"), message, self.clock.now())
        while starts:
            [start] = starts
            self.clock.advance_to(self.clock.now() + took_ms * MS)
            self.statistics.step(start.run.stage, Step.PROCESS, took_ms * MS)
            outputs = [Output(0, at_ms)] if start.run.stage == "work" else []
            starts = self.scheduler.step_done(start.run, self.clock.now(), outputs)

    def page(self) -> Mapping[str, Any]:
        before = len(self.board.pages)
        self.status.tick()
        assert len(self.board.pages) == before + 1
        return self.board.pages[-1]


@pytest.fixture
def case(monkeypatch: pytest.MonkeyPatch) -> Case:
    return Case(monkeypatch)


def test_while_a_graph_opens_its_board_says_so(case: Case) -> None:
    assert [page["state"] for page in case.board.pages] == ["opening"]


def test_a_page_is_put_up_twice_a_second(case: Case) -> None:
    case.begin()
    before = len(case.board.pages)
    for at_ms in range(0, 3000, 100):
        case.clock.advance_to(max(at_ms * MS, 1))
        case.status.tick()
    assert len(case.board.pages) - before == 3000 * MS // PERIOD_NS


def test_rates_ages_and_shares_are_those_of_the_last_seconds(case: Case) -> None:
    case.begin()
    for at_ms in range(100, 10_001, 100):
        case.frame(at_ms, took_ms=10)
        case.cpu_ns += 30 * MS
        if at_ms % 500 == 0:
            page = case.page()
    assert page["graph"] == "uav"
    assert page["cpu_cores"] == pytest.approx(0.3, rel=0.01)
    assert page["outputs"]["camera/out"] == {
        "count": 100,
        "rate_hz": 10.0,
        "silent_s": pytest.approx(0.02),  # the two steps
        "ages_ms": {"camera/out": 20.0},
    }
    assert page["outputs"]["work/out"]["ages_ms"] == {"camera/out": 30.0}
    work = page["stages"]["work"]
    assert work["runs"] == 100
    assert work["runs_hz"] == pytest.approx(10.0, rel=0.01)
    assert work["cpu_cores"] == pytest.approx(0.1, rel=0.01)
    assert (work["lost"], work["queued"], work["running"]) == (0, 0, 0)


def test_a_stream_that_ends_has_no_rate_once_the_window_is_over(case: Case) -> None:
    case.begin()
    for at_ms in range(100, 2001, 100):
        case.frame(at_ms)
    assert case.page()["outputs"]["camera/out"]["rate_hz"] == 10.0
    for step in range(1, WINDOW + 1):
        case.clock.advance_to(2000 * MS + step * PERIOD_NS)
        page = case.page()
    assert page["outputs"]["camera/out"]["rate_hz"] == 0.0
    assert page["outputs"]["camera/out"]["silent_s"] == pytest.approx(WINDOW * PERIOD_NS / 1e9)
    assert page["stages"]["work"]["runs_hz"] == 0.0


def test_a_lost_frame_counts_for_the_stage_that_did_not_take_it(case: Case) -> None:
    case.begin()
    for at_ms in (100, 200, 300):  # nobody works: each replaces the one before
        case.clock.advance_to(at_ms * MS)
        case.scheduler.publish(Port("camera"), Message.at(at_ms * MS, 0), case.clock.now())
    work = case.page()["stages"]["work"]
    assert (work["lost"], work["queued"], work["running"]) == (1, 1, 1)


def test_events_and_failures_are_on_the_page(case: Case) -> None:
    case.begin()
    case.statistics.event("stale", "edge", "text", 5 * MS)
    case.statistics.failed("work", ArithmeticError("no"), "", None, 6 * MS)
    page = case.page()
    assert page["events"][0] == {"at_s": 0.005, "kind": "stale", "of": "edge", "text": "text"}
    assert page["failures"] == ["work: ArithmeticError: no"]


def test_a_full_disk_does_not_end_the_run(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(page: Mapping[str, Any]) -> None:
        raise OSError(28, "No space left on device")

    case.begin()
    monkeypatch.setattr(case.board, "write", full)
    case.status.tick()
