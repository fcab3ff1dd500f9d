"""The scheduler held against its executable reference, and the laws that both must keep.

Every law runs on the reference too: a law that the definition breaks is a wrong definition.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from reference import ReferenceScheduler
from schedulers import REAL, every_scheduler, missing
from scripts import Arrival, Behavior, Script, behaviors, examples, scripts
from virtual_time import Scheduling, Trace, drive

from pipeline.scheduling.topology import (
    Input,
    Missing,
    Policy,
    Port,
    StageNode,
    Sync,
    Topology,
)


@missing
@examples(200)
@given(script=scripts(offline=False))
def test_live_the_scheduler_does_what_the_reference_does(script: Script) -> None:
    drive(script, ReferenceScheduler, REAL)


@missing
@examples(100)
@given(script=scripts(offline=True))
def test_offline_the_scheduler_does_what_the_reference_does(script: Script) -> None:
    drive(script, ReferenceScheduler, REAL)


@every_scheduler
@examples(30)
@given(script=scripts())
def test_books_balance_after_every_event_and_nothing_is_left_in_the_end(
    scheduler: type[Scheduling], script: Script
) -> None:
    drive(script, scheduler)  # which checks both


@every_scheduler
@examples(30)
@given(script=scripts(), deeper=st.integers(1, 3))
def test_results_leave_in_trigger_order_whatever_completes_first(
    scheduler: type[Scheduling], script: Script, deeper: int
) -> None:
    stages = tuple(
        node if node.is_source else replace(node, stateless=True, max_in_flight=deeper)
        for node in script.topology.stages
    )
    topology = replace(script.topology, stages=stages, workers=4)
    trace = drive(replace(script, topology=topology), scheduler)
    for node in stages:
        numbers = [number for _, stage, number, _ in trace.records("ended") if stage == node.name]
        assert numbers == sorted(set(numbers))
        in_order = [row[2] for row in trace.records("set") if row[1] == node.name]
        assert in_order == sorted(set(in_order))


def _results(trace: Trace) -> dict[str, list[Any]]:
    """What every port said: stamps, lineage (without arrival times) and payload, in order."""
    said: dict[str, list[Any]] = {}
    for _, port, stamp, begin, end, _, seq, lineage, payload, *_ in trace.records("published"):
        samples = tuple(sample[:2] for sample in lineage)
        said.setdefault(port, []).append((stamp, begin, end, seq, samples, payload))
    return said


@every_scheduler
@examples(30)
@given(script=scripts(offline=True), data=st.data(), workers=st.integers(1, 4))
def test_offline_results_do_not_depend_on_the_speed_or_number_of_workers(
    scheduler: type[Scheduling], script: Script, data: st.DataObject, workers: int
) -> None:
    paces = {
        name: replace(data.draw(behaviors(1)), says=behavior.says, later=behavior.later)
        for name, behavior in script.behaviors.items()
    }
    other = replace(script, behaviors=paces, topology=replace(script.topology, workers=workers))
    assert _results(drive(script, scheduler)) == _results(drive(other, scheduler))


# One trigger of period 10 and one other sensor

PERIOD, WAIT, TOLERANCE = 10, 24, 7


def _pair(missing: Missing, **rules: Any) -> Topology:
    scores = Input(
        "scores",
        (Port("camera"),),
        Sync.NEAREST,
        tolerance=TOLERANCE,
        max_wait=WAIT,
        missing=missing,
    )
    scan = Input("scan", (Port("lidar"),), policy=Policy.DROP_OLDEST, size=100)
    fuse = StageNode("fuse", (scan, replace(scores, **rules)), stateless=True, max_in_flight=50)
    return Topology((StageNode("lidar"), StageNode("camera"), fuse), workers=50)


def _stream(port: str, stamps: list[int], delays: list[int]) -> list[Arrival]:
    at, made = 0, []
    for stamp, delay in zip(stamps, delays, strict=False):
        at = max(at, stamp + delay)
        made.append(Arrival(at, Port(port), stamp, stamp, stamp))
    return made


def _flight(topology: Topology, *streams: list[Arrival]) -> Script:
    arrivals = sorted((a for stream in streams for a in stream), key=lambda a: a.at)
    return Script(topology, tuple(arrivals), {"fuse": Behavior()})


def _nearest(stamp: int, others: list[int]) -> int | None:
    near = [other for other in others if abs(other - stamp) <= TOLERANCE]
    return min(near, key=lambda other: (abs(other - stamp), other), default=None)


some_stamps = st.lists(st.integers(1, 15), min_size=1, max_size=15).map(
    lambda gaps: [sum(gaps[: n + 1]) for n in range(len(gaps))]
)


@every_scheduler
@examples(100)
@given(others=some_stamps, delays=st.lists(st.integers(0, 60), min_size=30, max_size=30))
def test_a_settled_nearest_is_the_nearest_of_the_whole_stream(
    scheduler: type[Scheduling], others: list[int], delays: list[int]
) -> None:
    scans = [PERIOD * n for n in range(15)]
    streams = _stream("lidar", scans, delays[:15]), _stream("camera", others, delays[15:])
    trace = drive(_flight(_pair(Missing.PROCEED), *streams), scheduler)
    for _, _, stamp, (_, chosen), marks in trace.records("set"):
        if not marks:
            assert chosen == _nearest(stamp, others)


@every_scheduler
@examples(100)
@given(
    others=st.lists(st.integers(-2, 2), min_size=15, max_size=20),
    jitter=st.lists(st.integers(0, 12), min_size=40, max_size=40),
)
def test_arrival_jitter_below_max_wait_changes_no_set(
    scheduler: type[Scheduling], others: list[int], jitter: list[int]
) -> None:
    """Waiting is at most a gap of the other stream (14) and the jitter (12), below max_wait."""
    scans = [PERIOD * n for n in range(12)]
    camera = [PERIOD * n + shift for n, shift in enumerate(others)]
    streams = _stream("lidar", scans, jitter[:12]), _stream("camera", camera, jitter[12:])
    trace = drive(_flight(_pair(Missing.SKIP, max_wait=30), *streams), scheduler)
    sets = [(stamp, values[1], marks) for _, _, stamp, values, marks in trace.records("set")]
    assert sets == [(scan, _nearest(scan, camera), ()) for scan in scans]


@every_scheduler
@examples(100)
@given(
    death=st.integers(0, 150),
    silence=st.integers(0, 120),
    delays=st.lists(st.integers(0, 3), min_size=80, max_size=80),
    phase=st.integers(0, 9),
)
def test_a_dead_sensor_delays_output_by_one_period_and_max_wait_and_is_used_again_at_once(
    scheduler: type[Scheduling], death: int, silence: int, delays: list[int], phase: int
) -> None:
    lidar = _stream("lidar", [PERIOD * n for n in range(30)], delays)
    camera = _stream("camera", [PERIOD * n + phase for n in range(30)], delays[30:])
    alive = [a for a in camera if not death <= a.stamp < death + silence]
    trace = drive(_flight(_pair(Missing.PROCEED), lidar, alive), scheduler)
    arrived = {a.stamp: a.at for a in lidar}
    sets = {stamp: (now, values[1]) for now, _, stamp, values, _ in trace.records("set")}
    assert sets.keys() == arrived.keys()  # no trigger is lost
    assert all(now - arrived[stamp] <= PERIOD + WAIT for stamp, (now, _) in sets.items())
    returned = min((a for a in alive if a.stamp >= death), key=lambda a: a.at, default=None)
    if returned is not None:
        for stamp, at in arrived.items():
            if at > returned.at and _nearest(stamp, [a.stamp for a in alive]) is not None:
                assert sets[stamp][1] is not None


@every_scheduler
def test_a_set_that_is_settled_in_the_instant_of_its_deadline_was_not_late(
    scheduler: type[Scheduling],
) -> None:
    """At 16 the LiDAR passes the frame of 14 over; so no scores of 14 come to the pose of 10."""
    frame, scan, pose, scores = Port("camera"), Port("lidar"), Port("odometry"), Port("net")
    net = StageNode("net", (Input("frame", (frame,)), Input("scan", (scan,), Sync.EXACT)))
    near = Input("scores", (scores,), Sync.NEAREST, tolerance=4, max_wait=6)
    fuse = StageNode("fuse", (Input("pose", (pose,)), near))
    sources = [StageNode(port.stage) for port in (frame, scan, pose)]
    arrivals = [Arrival(s, port, s, s, s) for s, port in ((10, pose), (14, frame), (16, scan))]
    script = Script(
        Topology((*sources, net, fuse), workers=1),
        tuple(arrivals),
        {"net": Behavior(), "fuse": Behavior()},
    )
    trace = drive(script, scheduler)
    lost = [
        (row[0], *row[2:])
        for row in trace.records("dropped")
        if row[1] == "odometry/out->fuse/pose"
    ]
    assert lost == [(16, 10, "set_skipped")]
    assert trace.records("stale") == []
