"""Lost devices worked by hand (section 7 of the scheduler's README): timeouts, checks, the ladder,
and the laws that both schedulers keep while devices come and go."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from schedulers import every_scheduler
from scripts import Arrival, Behavior, Script, examples, scripts
from virtual_time import Scheduling, Trace, drive

from pipeline.scheduling.topology import Input, OnError, Port, StageNode, Topology

MS, NEVER = 1_000_000, 10**15
IMAGE = Port("camera")
LADDER = ("npu", "cpu")


def network(name: str = "net", **rules: Any) -> StageNode:
    rules = {"devices": LADDER, "max_in_flight": 2, "on_error": OnError.SKIP, **rules}
    return StageNode(name, (Input("image", (IMAGE,)),), **rules)


def play(
    scheduler: type[Scheduling],
    node: StageNode,
    stamps: list[int],
    behavior: Behavior,
    *others: StageNode,
    check_every: int = 1000,
    checks: tuple[tuple[int, bool], ...] = (),
) -> Trace:
    frames = tuple(Arrival(stamp, IMAGE, stamp, stamp, stamp) for stamp in stamps)
    behaviors = {stage.name: Behavior() for stage in others} | {node.name: behavior}
    topology = Topology((StageNode("camera"), node, *others), check_every=check_every)
    return drive(Script(topology, frames, behaviors, checks=checks), scheduler)


def infers(trace: Trace) -> list[tuple[int, int, str]]:
    """(now, number of the run, device) of every infer that was started."""
    every = [(now, start) for now, _, seen in trace.steps for start in seen.starts]
    return [(now, start[1], start[3]) for now, start in every if start[2] == "infer"]


def checked(trace: Trace) -> list[int]:
    return [now for now, _, seen in trace.steps if seen.checks]


def instants(trace: Trace, kind: str) -> list[int]:
    return [row[0] for row in trace.records(kind)]


@every_scheduler
def test_an_infer_without_a_measurement_has_ten_seconds(scheduler: type[Scheduling]) -> None:
    trace = play(scheduler, network(), [0], Behavior((1,), (20_000 * MS,)))
    assert trace.records("device_hung")[0] == (10_000 * MS + 1, "npu")


@every_scheduler
@pytest.mark.parametrize(("usual", "timeout"), [(3, 100), (30, 300)])
def test_then_it_has_ten_times_the_longest_and_at_least_100_ms(
    scheduler: type[Scheduling], usual: int, timeout: int
) -> None:
    slow = Behavior((0,), (usual * MS, 1 * MS, 5_000 * MS), (0,))
    trace = play(scheduler, network(), [0, 1000 * MS, 2000 * MS], slow)
    assert trace.records("device_hung")[0] == ((2000 + timeout) * MS, "npu")


@every_scheduler
def test_a_hang_costs_a_run_one_timeout_and_its_late_result_is_ignored(
    scheduler: type[Scheduling],
) -> None:
    trace = play(scheduler, network(timeout=20), [0], Behavior((1,), (60, 60), (1,)))
    assert infers(trace) == [(1, 0, "npu"), (21, 0, "cpu")]
    assert [row[0] for row in trace.records("device_hung")] == [21, 41]
    lost_twice = [row[2:] for row in trace.records("ended")]
    assert lost_twice == [(0, "abandoned")]


@every_scheduler
def test_a_run_whose_infer_failed_goes_on_and_what_it_says_is_degraded(
    scheduler: type[Scheduling],
) -> None:
    """A stage downstream without a model passes the mark on."""
    after = StageNode("after", (Input("scores", (Port("net"),)),))
    says = Behavior((1,), (4,), (1,), ("lost", "all"))
    trace = play(scheduler, network(), [0, 1020], says, after)
    assert infers(trace) == [(1, 0, "npu"), (5, 0, "cpu"), (1021, 1, "npu")]
    assert checked(trace) == [1005]
    made = [(row[1], row[-2], row[-1]) for row in trace.records("published")]
    assert [row for row in made if row[0] != "camera/out"] == [
        ("net/out", "cpu", True),
        ("after/out", None, True),
        ("net/out", "npu", False),
        ("after/out", None, False),
    ]


@every_scheduler
def test_an_infer_that_failed_on_the_last_rung_is_a_failed_run(
    scheduler: type[Scheduling],
) -> None:
    trace = play(scheduler, network(), [0], Behavior((1,), (4,), (1,), ("lost all",)))
    assert trace.records("device_failed") == [(5, "npu"), (9, "cpu")]
    assert [row[2:] for row in trace.records("ended")] == [(0, "failed")]


@every_scheduler
def test_a_device_that_does_not_stay_is_checked_half_as_often_each_time(
    scheduler: type[Scheduling],
) -> None:
    """Every infer on it fails: 10, then 20, 40 ... after each loss, up to 320."""
    frames = list(range(0, 3000, 5))
    says = Behavior((0,), (1,), (0,), ("lost",))
    trace = play(scheduler, network(), frames, says, check_every=10)
    down, checks = instants(trace, "device_down"), checked(trace)
    pauses = [check - lost for lost, check in zip(down, checks, strict=False)]
    assert pauses[:8] == [10, 20, 40, 80, 160, 320, 320, 320]


@every_scheduler
def test_a_check_that_says_no_is_repeated_after_the_same_pause(
    scheduler: type[Scheduling],
) -> None:
    answers = ((3, False), (3, False), (3, True))
    says = Behavior((1,), (4,), (1,), ("lost", "all"))
    trace = play(scheduler, network(), [0], says, check_every=10, checks=answers)
    assert instants(trace, "device_down") == [5]
    assert checked(trace) == [15, 28, 41]
    assert instants(trace, "device_up") == [44]


@every_scheduler
def test_a_degraded_stage_keeps_to_its_longer_period(scheduler: type[Scheduling]) -> None:
    says = Behavior((1,), (1,), (1,), ("lost", "all"))
    node = network(degraded_period=20)
    trace = play(scheduler, node, list(range(0, 80, 10)), says)
    assert [row[2] for row in trace.records("set")] == [0, 20, 40, 60]
    reasons = {row[3] for row in trace.records("dropped")}
    assert reasons == {"decimated"}


@every_scheduler
def test_a_stopped_stage_takes_no_other_device(scheduler: type[Scheduling]) -> None:
    """Run 0 fails in finish while run 1 infers; the device is lost under run 1."""
    node = network(on_error=OnError.STOP, timeout=30)
    behavior = Behavior((0,), (5, 100), (5,), ("raise", "all"))
    trace = play(scheduler, node, [0, 2], behavior)
    assert infers(trace) == [(0, 0, "npu"), (5, 1, "npu")]
    assert [row[2:] for row in trace.records("ended")] == [(0, "failed"), (1, "abandoned")]


@every_scheduler
@examples(40)
@given(script=scripts(offline=False), data=st.data())
def test_a_lost_device_loses_no_run_that_has_a_later_rung_that_is_up(
    scheduler: type[Scheduling], script: Script, data: st.DataObject
) -> None:
    """A last rung that nothing takes away: no run is abandoned or failed for its device."""
    calm = {
        name: replace(behavior, says=data.draw(st.sampled_from([("all",), ("all", "lost")])))
        for name, behavior in script.behaviors.items()
    }
    stages = tuple(_with_last_rung(node) for node in script.topology.stages)
    topology = replace(script.topology, stages=stages)
    going = tuple(h for h in script.happenings if h.kind not in ("stop", "abandon"))
    trace = drive(replace(script, topology=topology, behaviors=calm, happenings=going), scheduler)
    assert {row[3] for row in trace.records("ended")} <= {"finished"}


def _with_last_rung(node: StageNode) -> StageNode:
    """The stage with a rung of its own, never lost, below its ladder, and no age limit."""
    if not node.devices:
        return node
    ageless = tuple(replace(entry, max_age=None) for entry in node.inputs)
    ladder = (*node.devices, f"rock of {node.name}")
    return replace(node, inputs=ageless, devices=ladder, timeout=NEVER)


@every_scheduler
@examples(40)
@given(script=scripts())
def test_a_message_is_degraded_exactly_when_a_lower_rung_had_a_part_in_it(
    scheduler: type[Scheduling], script: Script
) -> None:
    trace = drive(script, scheduler)
    node = {node.name: node for node in script.topology.stages}
    degraded: set[tuple[str, int]] = set()  # (port, stamp)
    used: dict[tuple[str, int], list[tuple[str, int]]] = {}  # by run
    sets: dict[str, int] = dict.fromkeys(node, 0)
    for _, _, seen in trace.steps:
        for kind, *row in seen.records:
            if kind == "set":
                stage, _, values, _ = row
                run = stage, sets[stage]
                sets[stage] += 1
                used[run] = list(_messages_of(node[stage], values))
            elif kind == "published":
                port, stamp, *_, payload, executor, mark = row
                stage, _, number = payload.partition("#")
                if not number:
                    assert (executor, mark) == (None, False)
                    continue
                ladder = node[stage].devices
                lower = bool(ladder) and executor != ladder[0]
                assert (executor is None) == (not ladder)
                assert mark == (lower or any(m in degraded for m in used[stage, int(number)]))
                if mark:
                    degraded.add((port, stamp))


def _messages_of(node: StageNode, values: tuple[Any, ...]) -> Any:
    """(port, stamp) of every message of a set."""
    for entry, value in zip(node.inputs, values, strict=True):
        shares = value if entry.many else (value,)
        for source, share in zip(entry.sources, shares, strict=True):
            for stamp in share if isinstance(share, tuple) else (share,):
                if stamp is not None:
                    yield str(source), stamp
