"""Wanted frames in a graph: what a settled input chooses under `run: every` it chooses under
`run: wanted`, of fewer runs; and the turns of those that may run, by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hypothesis import assume, given
from hypothesis import strategies as st
from schedulers import every_scheduler
from scripts import Arrival, Behavior, Script, examples
from virtual_time import Scheduling, Trace, drive

from pipeline.scheduling.topology import Input, Missing, Policy, Port, StageNode, Sync, Topology

IMAGE, SCAN, SCORES, THERMAL = Port("camera"), Port("lidar"), Port("net"), Port("thermal")


def network(**rules: Any) -> StageNode:
    image = Input("image", (IMAGE,))
    rules = {"devices": ("npu",), "max_in_flight": 2, "wanted": True, **rules}
    return StageNode("net", (image,), **rules)


def fusion(**rules: Any) -> StageNode:
    scan = Input("scan", (SCAN,), policy=Policy.DROP_OLDEST, size=100)
    rules = {"sync": Sync.NEAREST, "tolerance": 1000, "max_wait": 10_000, **rules}
    scores = Input("scores", (SCORES,), missing=Missing.PROCEED, **rules)
    return StageNode("fuse", (scan, scores), max_in_flight=50, stateless=True)


def viewer() -> StageNode:
    return StageNode("viewer", (Input("scores", (SCORES,)),), outputs=())


def stream(port: Port, stamps: range, delays: list[int]) -> list[Arrival]:
    at, made = 0, []
    for n, stamp in enumerate(stamps):
        at = max(at, stamp + delays[n % len(delays)])
        made.append(Arrival(at, port, stamp, stamp, stamp))
    return made


def play(
    scheduler: type[Scheduling],
    stages: list[StageNode],
    *streams: list[Arrival],
    offline: bool = False,
    **behaviors: Behavior,
) -> Trace:
    arrivals = sorted((a for stream in streams for a in stream), key=lambda a: a.at)
    how = {stage.name: behaviors.get(stage.name, Behavior((0,), (0,), (0,))) for stage in stages}
    topology = Topology((StageNode("camera"), StageNode("lidar"), *stages), workers=50)
    return drive(Script(topology, tuple(arrivals), how, offline=offline), scheduler)


def chosen(trace: Trace) -> dict[int, Any]:
    """What the fusion took for each scan."""
    return {row[2]: (row[3][1], row[4]) for row in trace.records("set") if row[1] == "fuse"}


def runs(trace: Trace) -> list[int]:
    """The frames that the network ran on."""
    return [row[2] for row in trace.records("set") if row[1] == "net"]


@every_scheduler
@examples(60)
@given(
    camera=st.integers(10, 40),
    lidar=st.integers(10, 90),
    phase=st.integers(0, 90),
    late=st.lists(st.integers(0, 4), min_size=1, max_size=5),
    tolerance=st.sampled_from([3, 20, 1000]),
    offset=st.integers(-8, 8),
    offline=st.booleans(),
)
def test_of_even_streams_a_settled_nearest_is_the_same_as_when_every_frame_is_run(
    scheduler: type[Scheduling],
    camera: int,
    lidar: int,
    phase: int,
    late: list[int],
    tolerance: int,
    offset: int,
    offline: bool,
) -> None:
    images = stream(IMAGE, range(0, 40 * camera, camera), late)
    scans = stream(SCAN, range(phase, 40 * camera, lidar), late[::-1])
    assume(len(scans) > 6)
    fuse = fusion(tolerance=tolerance, offset=offset)
    swift = Behavior((1,), (2,), (1,))
    every, wanted = (
        play(scheduler, [network(wanted=on), fuse], images, scans, offline=offline, net=swift)
        for on in (False, True)
    )
    whole = 38 * camera - abs(offset)  # later scans wish for frames that never come
    expected, got = (
        [(stamp, found) for stamp, found in chosen(trace).items() if stamp < whole]
        for trace in (every, wanted)
    )
    assert got == expected
    assert set(runs(wanted)) <= set(runs(every)) == {image.stamp for image in images}


@every_scheduler
@examples(60)
@given(
    thermal=st.integers(20, 90),
    lidar=st.integers(20, 90),
    phase=st.integers(0, 90),
    late=st.lists(st.integers(0, 4), min_size=1, max_size=5),
    tolerance=st.integers(2, 40),
    offline=st.booleans(),
)
def test_of_even_streams_frames_of_sets_that_are_skipped_are_all_that_is_left_out(
    scheduler: type[Scheduling],
    thermal: int,
    lidar: int,
    phase: int,
    late: list[int],
    tolerance: int,
    offline: bool,
) -> None:
    """The fusion needs a thermal image near each scan; where there is none, no image is run."""
    images = stream(IMAGE, range(0, 1200, 20), late)
    scans = stream(SCAN, range(phase, 1200, lidar), late[::-1])
    warm = stream(THERMAL, range(0, 1200, thermal), late)
    needed = Input("warm", (THERMAL,), sync=Sync.NEAREST, tolerance=tolerance, max_wait=10_000)
    fuse = fusion()
    fuse = replace(fuse, inputs=(*fuse.inputs, needed))
    swift = Behavior((1,), (2,), (1,))
    every, wanted = (
        play(
            scheduler,
            [StageNode("thermal"), network(wanted=on), fuse],
            *(images, scans, warm),
            offline=offline,
            net=swift,
        )
        for on in (False, True)
    )
    whole = [stamp for stamp in chosen(every) if stamp < 1200 - 2 * max(thermal, 20)]
    assert [chosen(wanted).get(stamp) for stamp in whole] == [chosen(every)[s] for s in whole]
    fused = {scores for scores, _ in chosen(every).values()}
    known = range(10 * max(thermal, lidar), max(whole, default=0))
    assert {frame for frame in runs(wanted) if frame in known} <= fused


@every_scheduler
def test_a_camera_three_times_as_fast_runs_a_third_of_its_frames(
    scheduler: type[Scheduling],
) -> None:
    images = stream(IMAGE, range(0, 3000, 30), [0])
    trace = play(scheduler, [network(), fusion()], images, stream(SCAN, range(5, 3000, 90), [0]))
    known = [stamp for stamp in runs(trace) if stamp > 5 * 90]
    assert known == list(range(540, 3000, 90))


@every_scheduler
def test_a_frame_that_may_run_makes_way_for_one_that_must(scheduler: type[Scheduling]) -> None:
    """An infer lasts 25, a frame comes every 10, a scan's frame every 60: 60 n. After it ends there
    is time for one more frame that only the viewer takes, never for two."""
    images = stream(IMAGE, range(0, 1200, 10), [0])
    scans = stream(SCAN, range(0, 1200, 60), [1])
    slow = Behavior((0,), (25,), (0,))
    trace = play(scheduler, [network(), fusion(tolerance=4), viewer()], images, scans, net=slow)
    sets = [row[0] for row in trace.records("set") if row[1] == "net"]
    started = [now for now in sets if 420 <= now < 1200]
    assert started == [420 + 60 * n + after for n in range(13) for after in (0, 25)]
    assert trace.records("wish_missed") == []


@every_scheduler
def test_a_wish_that_the_device_could_not_serve_is_told(scheduler: type[Scheduling]) -> None:
    images = stream(IMAGE, range(0, 1200, 10), [0])
    scans = stream(SCAN, range(0, 1200, 20), [1])
    trace = play(
        scheduler, [network(), fusion(tolerance=4)], images, scans, net=Behavior((0,), (50,), (0,))
    )
    missed = trace.records("wish_missed")
    assert missed
    assert {row[1] for row in missed} == {"net"}


@every_scheduler
def test_a_frame_waits_for_nobody_once_its_stream_has_ended(scheduler: type[Scheduling]) -> None:
    """It would wait for a frame that must run and never comes."""
    images = stream(IMAGE, range(0, 601, 10), [0])
    scans = stream(SCAN, range(8, 601, 60), [1])
    slow = Behavior((0,), (25,), (0,))
    trace = play(scheduler, [network(), fusion(tolerance=4), viewer()], images, scans, net=slow)
    assert runs(trace)[-1] == 600
