"""DESIGN 3 worked by hand, rule by rule, and a proof that the harness notices a wrong scheduler."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, find, settings
from reference import ReferenceScheduler
from schedulers import every_scheduler
from scripts import Arrival, Behavior, Happening, Script, scripts
from virtual_time import Mismatch, Scheduling, Trace, drive

from pipeline.scheduling.topology import (
    Input,
    Missing,
    OnError,
    Policy,
    Port,
    StageNode,
    Sync,
    Topology,
)

IMAGE, SCAN = Port("camera"), Port("lidar")


def at(port: Port, *instants: int | tuple[int, int]) -> list[Arrival]:
    """Messages by stamp, or by (stamp, arrival)."""
    pairs = [(n, n) if isinstance(n, int) else n for n in instants]
    return [Arrival(arrival, port, stamp, stamp, stamp) for stamp, arrival in pairs]


def play(
    scheduler: type[Scheduling],
    stages: list[StageNode],
    *arrivals: list[Arrival],
    happenings: tuple[Happening, ...] = (),
    offline: bool = False,
    workers: int = 2,
    promise: int | None = None,
    **behaviors: Behavior,
) -> Trace:
    """The stages behind a camera and a LiDAR; steps last 1 unless said otherwise."""
    sources = StageNode("camera", min_period=promise), StageNode("lidar")
    flight = sorted((a for stream in arrivals for a in stream), key=lambda arrival: arrival.at)
    how = {stage.name: behaviors.get(stage.name, Behavior()) for stage in stages}
    topology = Topology((*sources, *stages), workers)
    return drive(Script(topology, tuple(flight), how, happenings, offline), scheduler)


def image(**rules: Any) -> Input:
    return Input("image", (IMAGE,), **rules)


def stage(name: str, *inputs: Input, **rules: Any) -> StageNode:
    return StageNode(name, inputs, **rules)


def fuse(missing: Missing = Missing.PROCEED, **rules: Any) -> StageNode:
    """Triggered by scans, with an image under `rules`."""
    every = Input("scan", (SCAN,), policy=Policy.DROP_OLDEST, size=100)
    return stage("fuse", every, image(missing=missing, **rules))


def sets(trace: Trace, name: str = "fuse") -> list[tuple[Any, ...]]:
    """(now, trigger, the other input's stamps, the word of its mark)."""
    rows = [row for row in trace.records("set") if row[1] == name]
    return [(now, stamp, v[-1], *(m[2].value for m in marks)) for now, _, stamp, v, marks in rows]


def drops(trace: Trace, edge: str) -> list[tuple[int, str]]:
    return [(row[2], row[3]) for row in trace.records("dropped") if row[1].endswith(edge)]


@every_scheduler
def test_a_latest_queue_keeps_the_newest_while_the_stage_is_busy(
    scheduler: type[Scheduling],
) -> None:
    trace = play(scheduler, [stage("a", image())], at(IMAGE, 0, 3, 6, 12), a=Behavior((10,)))
    assert [row[:2] for row in sets(trace, "a")] == [(0, 0), (10, 6), (20, 12)]
    assert drops(trace, "a/image") == [(3, "replaced")]


@every_scheduler
def test_a_port_refuses_backward_and_early_stamps_and_then_distrusts_the_promise(
    scheduler: type[Scheduling],
) -> None:
    stamps = at(IMAGE, 10, (9, 11), (15, 16), (20, 20), (21, 21))
    trace = play(scheduler, [stage("a", image())], stamps, promise=10)
    refused = [row[2:] for row in trace.records("refused")]
    assert refused == [(9, "backward"), (15, "early")]  # 21 comes under the promise withdrawn


@every_scheduler
def test_nearest_waits_only_until_no_closer_message_can_come(scheduler: type[Scheduling]) -> None:
    """At T = 10 the image 7 has gap 3, so the bound must reach 13: the message 12 is not enough
    to say so, and is itself nearer (gap 2: bound 12 + 1 >= 12)."""
    node = fuse(sync=Sync.NEAREST, tolerance=5, max_wait=100)
    trace = play(scheduler, [node], at(SCAN, 10), at(IMAGE, 7, (12, 20)))
    assert sets(trace) == [(20, 10, 12)]
    assert drops(trace, "fuse/image") == [(7, "passed_over")]


@every_scheduler
def test_nearest_gives_ties_to_the_earlier_at_once(scheduler: type[Scheduling]) -> None:
    node = fuse(sync=Sync.NEAREST, tolerance=5, max_wait=100)
    trace = play(scheduler, [node], at(SCAN, 10), at(IMAGE, 8, (12, 20)))
    assert sets(trace) == [(20, 10, 8)]


@every_scheduler
def test_a_promise_settles_a_set_before_the_next_message(scheduler: type[Scheduling]) -> None:
    node = fuse(sync=Sync.NEAREST, tolerance=5, max_wait=100)
    trace = play(scheduler, [node], at(SCAN, 10), at(IMAGE, 8, 18), promise=10)
    assert sets(trace) == [(10, 10, 8)]


@every_scheduler
def test_exact_goes_without_once_the_bound_has_passed(scheduler: type[Scheduling]) -> None:
    node = fuse(sync=Sync.EXACT, max_wait=100)
    trace = play(scheduler, [node], at(SCAN, 10, 20), at(IMAGE, (10, 15), (25, 30)))
    assert sets(trace) == [(15, 10, 10), (30, 20, None, "missing")]


@every_scheduler
def test_latest_takes_what_is_held_live_and_waits_for_certainty_offline(
    scheduler: type[Scheduling],
) -> None:
    streams = at(SCAN, 10), at(IMAGE, 3, (9, 12), (30, 30))
    node = fuse(sync=Sync.LATEST)
    assert sets(play(scheduler, [node], *streams)) == [(10, 10, 3)]
    assert [row[1:] for row in sets(play(scheduler, [node], *streams, offline=True))] == [(10, 9)]


@every_scheduler
def test_a_span_covers_the_chosen_set_and_one_message_on_each_side(
    scheduler: type[Scheduling],
) -> None:
    node = fuse(sync=Sync.SPAN, max_wait=100)
    scan = [Arrival(20, SCAN, 15, 10, 20)]
    trace = play(scheduler, [node], scan, at(IMAGE, 2, 8, 14, 19, 23, 30))
    assert sets(trace) == [(23, 15, (8, 14, 19, 23))]


@every_scheduler
def test_a_timeout_makes_the_slot_stale_and_a_message_in_time_recovers_it(
    scheduler: type[Scheduling],
) -> None:
    """20 waits 15 and finds 18 within tolerance but unsettled; 40 does not wait; the image 61
    arrives when the newest trigger that has timed out is 40, so 70 waits again."""
    node = fuse(sync=Sync.NEAREST, tolerance=5, max_wait=15)
    trace = play(scheduler, [node], at(SCAN, 20, 40, 70), at(IMAGE, 18, 61, (70, 75)))
    assert sets(trace) == [(35, 20, 18, "unsettled"), (40, 40, None, "missing"), (75, 70, 70)]
    assert [row[0] for row in trace.records("stale")] == [35]
    assert [row[0] for row in trace.records("recovered")] == [61]


@every_scheduler
def test_missing_says_hold_or_skip(scheduler: type[Scheduling]) -> None:
    streams = at(SCAN, 20, 50), at(IMAGE, 10, 70)
    hold = fuse(Missing.HOLD, sync=Sync.NEAREST, tolerance=5, max_wait=100, hold=20)
    assert sets(play(scheduler, [hold], *streams)) == [
        (70, 20, 10, "held"),
        (71, 50, None, "missing"),
    ]
    skip = fuse(Missing.SKIP, sync=Sync.NEAREST, tolerance=5, max_wait=100)
    trace = play(scheduler, [skip], *streams)
    assert sets(trace) == []
    assert drops(trace, "fuse/scan") == [(20, "set_skipped"), (50, "set_skipped")]


@every_scheduler
def test_a_fifth_set_forces_the_oldest(scheduler: type[Scheduling]) -> None:
    node = fuse(sync=Sync.NEAREST, tolerance=5, max_wait=1000)
    trace = play(scheduler, [node], at(SCAN, 0, 10, 20, 30, 40), at(IMAGE, (100, 100)))
    assert sets(trace)[0] == (40, 0, None, "missing")
    assert [row[0] for row in sets(trace)[1:]] == [100, 101, 102, 103]
    assert trace.records("stale") == []


@every_scheduler
def test_a_select_group_takes_the_same_frames(scheduler: type[Scheduling]) -> None:
    """5 is decided when the fast member takes it; the next frame when the slow one has it too."""
    pair = [stage(name, image(select="rgb")) for name in ("fast", "slow")]
    trace = play(scheduler, pair, at(IMAGE, 0, 5, 10, 15, 20), slow=Behavior((20,)))
    assert [row[:2] for row in sets(trace, "slow")] == [(0, 0), (20, 5), (40, 15), (60, 20)]
    assert [row[:2] for row in sets(trace, "fast")] == [(0, 0), (5, 5), (20, 15), (40, 20)]
    assert drops(trace, "fast/image") == drops(trace, "slow/image") == [(10, "replaced")]


@every_scheduler
def test_rate_hz_keeps_every_third_frame_of_three_times_the_rate(
    scheduler: type[Scheduling],
) -> None:
    jittered = at(IMAGE, 0, 34, 66, 99, 134, 166, 199)
    trace = play(scheduler, [stage("a", image(period=100))], jittered)
    assert [row[1] for row in sets(trace, "a")] == [0, 99, 199]


@every_scheduler
def test_a_blocked_source_waits_until_the_queue_has_room(scheduler: type[Scheduling]) -> None:
    node = stage("a", image(policy=Policy.BLOCK, size=2))
    trace = play(scheduler, [node], at(IMAGE, 0, 1, 2, 3), a=Behavior((10,)))
    assert [(row[0], row[2]) for row in trace.records("published") if "camera" in row[1]] == [
        (0, 0),
        (1, 1),
        (2, 2),
        (10, 3),
    ]
    assert drops(trace, "a/image") == []


@every_scheduler
def test_results_leave_in_trigger_order(scheduler: type[Scheduling]) -> None:
    node = stage("a", image(), max_in_flight=2, stateless=True)
    trace = play(scheduler, [node], at(IMAGE, 0, 1), a=Behavior((10, 3)))
    assert [row[:3] for row in trace.records("ended")] == [(10, "a", 0), (10, "a", 1)]


@every_scheduler
def test_the_next_prepare_starts_just_in_time_for_the_device(scheduler: type[Scheduling]) -> None:
    """Infer lasts 20, prepare 5: from the second infer (25 to 45) on, prepare starts at 40."""
    node = stage("net", image(), devices=("npu",), max_in_flight=3)
    frames = at(IMAGE, *range(0, 100, 4))
    trace = play(scheduler, [node], frames, net=Behavior((5,), (20,), (1,)))
    starts = [(now, s[2].value) for now, _, seen in trace.steps for s in seen.starts]
    assert [now for now, step in starts if step == "infer"][:4] == [5, 25, 45, 65]
    assert [now for now, step in starts if step == "prepare"][:5] == [0, 5, 40, 60, 80]


@every_scheduler
def test_a_lost_device_hands_its_run_to_the_next_rung_and_is_not_listened_to_any_more(
    scheduler: type[Scheduling],
) -> None:
    node = stage("net", image(), devices=("npu", "cpu"), max_in_flight=2)
    lost = (Happening(5, "down", "npu"),)
    trace = play(scheduler, [node], at(IMAGE, 0), happenings=lost, net=Behavior((1,), (10,), (1,)))
    starts = [(now, s[2].value, s[3]) for now, _, seen in trace.steps for s in seen.starts]
    assert starts == [
        (0, "prepare", "npu"),
        (1, "infer", "npu"),
        (5, "infer", "cpu"),
        (15, "finish", "cpu"),
    ]


@every_scheduler
def test_a_failure_stops_its_stage_and_ends_its_stream(scheduler: type[Scheduling]) -> None:
    """The fused set of 20 does without the image at once: its stream has ended."""
    failing = stage("a", image(), on_error=OnError.STOP)
    late = Input("late", (Port("a"),), Sync.EXACT, max_wait=1000, missing=Missing.PROCEED)
    node = stage("fuse", Input("scan", (SCAN,)), late)
    flight = at(SCAN, 10, 20), at(IMAGE, 10, 20)
    trace = play(scheduler, [failing, node], *flight, a=Behavior(says=("all", "raise")))
    assert sets(trace) == [(11, 10, 10), (21, 20, None, "missing")]
    assert [row[1:] for row in trace.records("ended") if row[1] == "a"] == [
        ("a", 0, "finished"),
        ("a", 1, "failed"),
    ]


@every_scheduler
def test_max_age_is_asked_when_a_run_starts_and_before_infer(scheduler: type[Scheduling]) -> None:
    node = stage("net", image(max_age=12), devices=("npu",), max_in_flight=2)
    slow = Behavior((2,), (20,), (1,))
    trace = play(scheduler, [node], at(IMAGE, 0, 3, (5, 40)), net=slow)
    assert [row[2:] for row in trace.records("ended")] == [(0, "finished"), (1, "abandoned")]
    assert drops(trace, "net/image") == [(5, "too_old")]


class LaterTies(ReferenceScheduler):
    def _verdict(self, edge: Any, T: int, lo: int, hi: int) -> Any:
        settled, found = super()._verdict(edge, T, lo, hi)
        twins = [i for i in edge.held("slot") if found and i.s - T == T - found[0].s]
        return settled, twins[-1:] if edge.input.sync is Sync.NEAREST and twins else found


class Forgetful(ReferenceScheduler):
    def _useless(self, edge: Any, item: Any, n: float) -> bool:
        return bool(item.s < self._least(edge.node))


class Patient(ReferenceScheduler):
    def _forced(self, node: StageNode) -> bool:
        return False


class Gullible(ReferenceScheduler):
    def _timed_out_triggers(self, edge: Any) -> list[int]:
        return []


class Hasty(ReferenceScheduler):
    def _prepare_time(self, node: StageNode) -> int:
        return 1_000_000_000_000


class Unfair(ReferenceScheduler):
    def _last_turn(self, node: StageNode) -> int:
        return 0


class Ageless(ReferenceScheduler):
    def _too_old(self, node: StageNode, stamp: int) -> bool:
        return False


class Unordered(ReferenceScheduler):
    def _leave(self, node: StageNode) -> None:
        self.jobs[node.name].sort(key=lambda job: not job.how)
        super()._leave(node)


class Overconfident(ReferenceScheduler):
    def _bound(self, port: Port) -> float:
        node = self.node[port.stage]
        return super()._bound(port) if node.is_source else self._bound(self._trigger(node).source)


MUTANTS = [
    LaterTies, Forgetful, Patient, Gullible, Hasty, Unfair, Ageless, Unordered, Overconfident
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("mutant", MUTANTS)
def test_the_harness_notices_a_scheduler_that_breaks_one_rule(
    mutant: type[ReferenceScheduler],
) -> None:
    def differs(script: Script) -> bool:
        try:
            drive(script, ReferenceScheduler, mutant)
        except Mismatch:
            return True
        return False

    search = settings(
        max_examples=3000,
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    assert find(scripts(offline=False), differs, settings=search)
