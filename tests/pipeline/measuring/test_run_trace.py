from __future__ import annotations

import gc
import weakref
from collections import Counter
from dataclasses import dataclass
from typing import Any

import pytest
from driving import MS, Apply, Collect, Pair, beat, drive
from hypothesis import given
from hypothesis import strategies as st

from pipeline.measuring.trace import Trace
from pipeline.measuring.trace_entries import (
    Dropped,
    Published,
    RunEnded,
    Sampled,
    SetFormed,
    Stepped,
    Told,
)
from pipeline.message import Message, Sample
from pipeline.scheduling.events import InputSet, Mark, Reason, Refusal
from pipeline.scheduling.topology import Input, Policy, Port, StageNode, Sync

NODES = [
    StageNode("camera"),
    StageNode("lidar"),
    StageNode("work", (Input("x", (Port("camera"),), policy=Policy.BLOCK, size=4),)),
    StageNode(
        "pair",
        (
            Input("a", (Port("lidar"),), policy=Policy.BLOCK, size=4),
            Input("b", (Port("work"),), sync=Sync.NEAREST, tolerance=20 * MS, max_wait=60_000 * MS),
        ),
    ),
    StageNode("sink", (Input("x", (Port("pair"),), policy=Policy.BLOCK, size=4),), outputs=()),
]


def traced(*, live: bool, capacity: int = 10_000) -> tuple[Trace, dict[str, dict[str, int]]]:
    """A short run, and its books of runs."""
    trace = Trace(capacity)
    stages = {"work": Apply(lambda x: x), "pair": Pair(), "sink": Collect()}
    sources = {"camera": beat(12, 10), "lidar": beat(4, 30)}
    ran = drive(NODES, stages, sources, live=live, trace=trace)
    assert not ran.statistics.failures
    return trace, ran.runs


def test_a_trace_keeps_at_least_one_entry() -> None:
    with pytest.raises(ValueError, match="at least one"):
        Trace(0)


@given(st.integers(1, 20), st.integers(0, 50))
def test_the_last_entries_stay_and_the_others_are_counted(capacity: int, told: int) -> None:
    trace = Trace(capacity)
    for number in range(told):
        trace.told("kind", "subject", str(number), number)
    texts = [entry.text for entry in trace.entries() if isinstance(entry, Told)]
    assert texts == [str(number) for number in range(told)][-capacity:]
    assert trace.recorded == told
    assert trace.overwritten == max(0, told - capacity)


@pytest.mark.parametrize("live", [False, pytest.param(True, marks=pytest.mark.realtime)])
def test_every_message_run_step_and_sample_is_entered(live: bool) -> None:
    trace, runs = traced(live=live)
    entries = trace.entries()
    published = Counter(entry.stage for entry in entries if isinstance(entry, Published))
    assert published == {"camera": 12, "lidar": 4, "work": 12, "pair": 4}
    sampled = Counter(entry.stage for entry in entries if isinstance(entry, Sampled))
    assert sampled == {"camera": 12, "lidar": 4}
    for kind in (SetFormed, Stepped, RunEnded):
        found = Counter(entry.stage for entry in entries if isinstance(entry, kind))
        assert found == {name: book["started"] for name, book in runs.items()}
    assert trace.overwritten == 0


def test_entries_follow_each_other_in_time_and_in_cause() -> None:
    trace, _ = traced(live=False)
    formed = {(e.stage, e.number): e.at for e in trace.entries() if isinstance(e, SetFormed)}
    ended = {(e.stage, e.number): e.at for e in trace.entries() if isinstance(e, RunEnded)}
    steps = [entry for entry in trace.entries() if isinstance(entry, Stepped)]
    assert all(
        formed[step.stage, step.number] <= step.at <= step.end <= ended[step.stage, step.number]
        for step in steps
    )


def test_a_set_names_the_messages_that_it_chose() -> None:
    trace, _ = traced(live=False)
    published: dict[tuple[str, Any], int] = {
        (e.stage, e.seq): e.stamp for e in trace.entries() if isinstance(e, Published)
    }
    pairs = [e for e in trace.entries() if isinstance(e, SetFormed) and e.stage == "pair"]
    for number, formed in enumerate(pairs):
        lidar, work = formed.chosen
        assert formed.number == number
        assert published["lidar", lidar] == published["work", work] == formed.trigger


@dataclass
class Payload:
    """Something that a weak reference can watch."""


def _message(payload: object = None) -> Message[object]:
    lineage = tuple(Sample(f"sensor/{n % 2}", 10 - n, 10 - n) for n in range(4))
    return Message(payload, 10, 10, 10, 11, 3, lineage)


def _entered(payload: object = None) -> Trace:
    """A trace with one entry of each kind that the scheduler brings."""
    trace = Trace()
    message = _message(payload)
    trace.published(Port("a"), message, 20)
    trace.refused(Port("a"), message, Refusal.BACKWARD, 20)
    trace.dropped(Port("a"), "b", "x", message, Reason.REPLACED, 20)
    marks = (("y", 0, Mark.MISSING),)
    trace.set_formed("b", InputSet(message, (message, (message, None), None), marks), 20)
    trace.told("kind", "subject", "text", 20)
    return trace


def test_a_trace_keeps_no_payload_alive() -> None:
    payload = Payload()
    gone = weakref.ref(payload)
    trace = _entered(payload)
    del payload
    assert gone() is None
    assert trace.recorded == 5


def test_the_garbage_collector_need_not_look_into_entries() -> None:
    trace = _entered()
    for _ in range(3):  # a tuple is let go a collection after those that it holds
        gc.collect()
    assert [entry for entry in trace._ring if gc.is_tracked(entry)] == []


def test_the_oldest_sample_of_each_stream_is_entered() -> None:
    published = next(e for e in _entered().entries() if isinstance(e, Published))
    assert dict(published.oldest) == {"sensor/0": 8, "sensor/1": 7}
    assert (published.stamp, published.now, published.seq) == (10, 20, 3)


def test_reasons_and_marks_are_entered_as_words() -> None:
    entries = _entered().entries()
    assert next(e.reason for e in entries if isinstance(e, Dropped)) == "replaced"
    formed = next(e for e in entries if isinstance(e, SetFormed))
    assert formed.chosen == (3, (3, None), None)
    assert formed.marks == (("y", 0, "missing"),)


def test_a_step_that_raises_is_entered_too() -> None:
    def fail(value: object) -> object:
        raise ArithmeticError("no")

    trace = Trace()
    nodes = [StageNode("source"), StageNode("work", (Input("x", (Port("source"),)),))]
    drive(nodes, {"work": Apply(fail)}, {"source": beat(1, 1)}, live=False, trace=trace)
    kinds = [type(entry) for entry in trace.entries() if getattr(entry, "stage", "") == "work"]
    assert kinds == [SetFormed, Stepped, RunEnded]
