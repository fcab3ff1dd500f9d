"""Each verdict on an input, the waiting and its causes, as the recorded events tell them."""

from __future__ import annotations

from pathlib import Path

import pytest
from recording_runs import MS, recorder, topology

from pipeline.message import Message
from pipeline.recording.explanation import Explanation, TriggerStory, explain
from pipeline.recording.flight import Flight
from pipeline.recording.tap import TappedScheduler
from pipeline.recording.tuning import suggestions
from pipeline.scheduling.events import Output, Start
from pipeline.scheduling.topology import Port


class Flown:
    """Plays a script of arrivals by hand; every run of `fuse` takes 3 ms."""

    def __init__(self, scheduler: TappedScheduler) -> None:
        self._scheduler = scheduler
        self._over: list[tuple[int, Start]] = []

    def at(self, now_ms: float, source: str | None = None, stamp_ms: float = 0) -> None:
        """A message arrives, or (without a source) the clock strikes."""
        now = round(now_ms * MS)
        while self._over and self._over[0][0] <= now:
            ended, start = self._over.pop(0)
            says = [Output(0, 1)] if start.run.stage == "fuse" else []
            self._run(self._scheduler.step_done(start.run, ended, says), ended)
        if source is None:
            self._run(self._scheduler.time(now), now)
        else:
            message = Message.at(round(stamp_ms * MS), 1)
            self._run(self._scheduler.publish(Port(source), message, now), now)

    def _run(self, actions: list[Start], now: int) -> None:
        for start in actions:
            took = 3 * MS if start.run.stage == "fuse" else 0
            self._over.append((now + took, start))
            self._over.sort(key=lambda entry: entry[0])


@pytest.fixture(scope="module")
def explanation(tmp_path_factory: pytest.TempPathFactory) -> Explanation:
    path = tmp_path_factory.mktemp("flight") / "f.mcap"
    of = topology()
    with recorder(path, of) as kept:
        flown = Flown(kept.scheduler(of))
        flown.at(1, "lidar", 0)
        flown.at(6, "camera", 5)  # proves that nothing is nearer
        flown.at(101, "lidar", 100)
        flown.at(122, "camera", 120)  # proves that nothing is within 8 ms ...
        flown.at(201, "lidar", 200)
        flown.at(221)  # ... 20 ms are over
        flown.at(230, "camera", 203)
        flown.at(301, "lidar", 300)
        flown.at(303, "camera", 295)
        flown.at(321)
        flown.at(330, "camera", 302)
        flown.at(401, "lidar", 400)
        flown.at(402, "camera", 401)
        flown.at(403, "lidar", 403)  # while the run of 400 is not over
        flown.at(403.5, "lidar", 403.4)
        flown.at(420, "camera", 420)
        flown.at(441)
        flown.at(600, "lidar", 600)
        flown.at(610)
    return explain(Flight(path), "fuse")


def story(explanation: Explanation, stamp_ms: float) -> TriggerStory:
    return next(one for one in explanation.triggers if one.stamp == round(stamp_ms * MS))


@pytest.mark.parametrize(
    ("stamp_ms", "verdict", "waited_ms", "why"),
    [
        (0, "settled", 5, "+5.0 ms"),
        (100, "nothing", 21, "within 8 ms; the nearest that ever came is +20.0 ms"),
        (200, "late", 20, "+3.0 ms came 9.0 ms after its wait of 20 ms was over"),
        (
            *(300, "unproven", 20),
            "-5.0 ms taken when its wait of 20 ms was over; +2.0 ms came 9.0 ms later",
        ),
    ],
)
def test_an_input_has_its_verdict(
    explanation: Explanation, stamp_ms: int, verdict: str, waited_ms: float, why: str
) -> None:
    told = story(explanation, stamp_ms)
    (image,) = told.inputs
    assert told.outcome == "fired"
    assert told.waited_ms == pytest.approx(waited_ms)
    assert told.waits == {"camera/out->fuse/b": pytest.approx(waited_ms)}
    assert (image.verdict, image.why) == (verdict, why)


def test_a_trigger_says_what_else_it_waited_for_and_why_it_was_lost(
    explanation: Explanation,
) -> None:
    lost, next_one = story(explanation, 403), story(explanation, 403.4)
    assert lost.outcome == "replaced"
    assert lost.waits == {"running": pytest.approx(0.5)}
    assert next_one.outcome == "fired"
    assert next_one.waits["running"] == pytest.approx(1.5)
    assert next_one.waits["camera/out->fuse/b"] == pytest.approx(15.0)
    waits = story(explanation, 600)
    assert (waits.outcome, waits.decided_s) == ("open", None)
    assert waits.inputs[0].why == "the nearest that ever came is -180.0 ms"


def test_runs_are_numbered_as_the_scheduler_did(explanation: Explanation) -> None:
    fired = [one for one in explanation.triggers if one.outcome == "fired"]
    assert [one.run for one in fired] == list(range(len(fired)))


def test_too_few_triggers_make_no_suggestion(explanation: Explanation) -> None:
    assert suggestions(explanation) == []


@pytest.mark.parametrize(
    ("period_ms", "shift_ms", "offset_ms", "tolerance_ms"),
    [(20.0, 6.0, -6.0, 1.0), (21.0, 0.0, 0.0, 12.0)],
)
def test_a_suggestion_tells_locked_clocks_from_free_ones(
    tmp_path: Path, period_ms: float, shift_ms: float, offset_ms: float, tolerance_ms: float
) -> None:
    of = topology()
    with recorder(tmp_path / "f.mcap", of) as kept:
        flown = Flown(kept.scheduler(of))
        entries = [(40 * n + 1, "lidar", 40.0 * n) for n in range(60)]
        entries += [
            (period_ms * n + shift_ms + 2, "camera", period_ms * n + shift_ms) for n in range(115)
        ]
        for entry in sorted(entries):
            flown.at(*entry)
    (found,) = suggestions(explain(Flight(tmp_path / "f.mcap"), "fuse"))
    assert found.suggested_offset_ms == pytest.approx(offset_ms)
    assert found.suggested_tolerance_ms == pytest.approx(tolerance_ms, abs=1)
    assert ("locked" in found.why) == (shift_ms > 0)


def test_a_stream_with_holes_asks_for_no_tolerance_as_wide_as_its_holes(tmp_path: Path) -> None:
    of = topology()
    with recorder(tmp_path / "f.mcap", of) as kept:
        flown = Flown(kept.scheduler(of))
        entries = [(40 * n + 1, "lidar", 40.0 * n) for n in range(60)]
        entries += [(21.0 * n + 2, "camera", 21.0 * n) for n in range(115) if not 40 <= n < 60]
        for entry in sorted(entries):
            flown.at(*entry)
    (found,) = suggestions(explain(Flight(tmp_path / "f.mcap"), "fuse"))
    assert found.suggested_tolerance_ms == pytest.approx(12, abs=1)
    assert found.suggested_max_wait_ms < 40
    assert "holes" in found.why
