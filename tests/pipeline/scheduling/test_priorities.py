"""Priorities on a shared device: what a guest may cost the one that comes first."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from schedulers import every_scheduler
from scripts import Arrival, Behavior, Script, examples
from virtual_time import Scheduling, StepKey, Trace, drive

from pipeline.scheduling.events import Step
from pipeline.scheduling.topology import Input, Port, StageNode, Topology

#: Runs until the scheduler has measured what a guest takes.
WARM_UP = 4
PERIODS = 14
GUESTS = ("guest", "other")


def _pilot_and_guests(
    period: int, prepare: int, infer: int, guest_prepare: int, guest_infer: int, priority: int
) -> Script:
    """A pilot at `period` and two guests that always have a frame, on one device."""
    camera, thermal = StageNode("camera"), StageNode("thermal")
    pilot = StageNode(
        "pilot",
        (Input("x", (Port("camera"),)),),
        devices=("tpu",),
        max_in_flight=2,
        priority=priority,
    )
    frames = (Input("x", (Port("thermal"),)),)
    guests = [StageNode(name, frames, devices=("tpu",), max_in_flight=2) for name in GUESTS]
    end = PERIODS * period
    arrivals = [Arrival(at, Port("camera"), at, at, at) for at in range(0, end, period)]
    arrivals += [Arrival(at, Port("thermal"), at, at, at) for at in range(0, end, 7)]
    behaviors = {
        "pilot": Behavior((prepare,), (infer,), (0,)),
        **dict.fromkeys(GUESTS, Behavior((guest_prepare,), (guest_infer,), (0,))),
    }
    topology = Topology((camera, thermal, pilot, *guests), workers=4)
    return Script(topology, tuple(sorted(arrivals, key=lambda a: a.at)), behaviors)


def _delays(trace: Trace, prepare: int) -> list[int]:
    """By how much each infer of the pilot starts after its frame has come and is prepared."""
    started = {
        start[1]: now for now, _, seen in trace.steps for start in seen.starts if _infers(start)
    }
    stamps = [stamp for _, stage, stamp, *_ in trace.records("set") if stage == "pilot"]
    return [started[number] - stamp - prepare for number, stamp in enumerate(stamps)]


def _infers(start: tuple[object, ...]) -> bool:
    key = StepKey(*start[:4])  # type: ignore[arg-type]
    return key.stage == "pilot" and key.step is Step.INFER


short, long = st.integers(1, 10), st.integers(5, 60)


@every_scheduler
@examples(25)
@given(slack=st.integers(1, 60), prepare=short, infer=long, guest_prepare=short, guest_infer=long)
def test_a_guest_delays_a_higher_priority_by_at_most_one_run_of_its_own(
    scheduler: type[Scheduling],
    slack: int,
    prepare: int,
    infer: int,
    guest_prepare: int,
    guest_infer: int,
) -> None:
    period = prepare + infer + guest_prepare + guest_infer + slack
    script = _pilot_and_guests(period, prepare, infer, guest_prepare, guest_infer, priority=1)
    delays = _delays(drive(script, scheduler), prepare)
    assert max(delays[WARM_UP:]) <= guest_prepare + guest_infer


@every_scheduler
def test_a_guest_of_equal_rank_may_take_its_turn_before(scheduler: type[Scheduling]) -> None:
    """So the law above is one of priorities."""
    script = _pilot_and_guests(50, 5, 10, 5, 40, priority=0)
    assert max(_delays(drive(script, scheduler), 5)[WARM_UP:]) > 5 + 40


@pytest.mark.parametrize("priority", [0, 1])
@every_scheduler
def test_the_guest_takes_what_the_pilot_leaves(scheduler: type[Scheduling], priority: int) -> None:
    trace = drive(_pilot_and_guests(100, 5, 20, 5, 20, priority=priority), scheduler)
    guests = [stage for _, stage, *_ in trace.records("set") if stage in GUESTS]
    assert len(guests) > 2.5 * PERIODS  # of 80 ns that are left in 100, three runs of 20
