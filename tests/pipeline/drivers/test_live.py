"""The live driver: real threads and the real clock, whose bounds a busy machine can keep."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from driving import MS, Apply, Collect, Pair, beat, drive

from pipeline.message import Message
from pipeline.scheduling.ledger import balanced
from pipeline.scheduling.topology import Input, OnError, Policy, Port, StageNode, Sync

pytestmark = pytest.mark.realtime


def _chain(policy: Policy = Policy.LATEST, size: int = 1) -> list[StageNode]:
    return [
        StageNode("source"),
        StageNode("work", (Input("x", (Port("source"),), policy=policy, size=size),)),
        StageNode("sink", (Input("x", (Port("work"),), policy=Policy.BLOCK, size=4),), outputs=()),
    ]


def _lossless() -> Input:
    return Input("x", (Port("source"),), policy=Policy.BLOCK, size=20)


def test_messages_arrive_at_their_time_and_in_order() -> None:
    sink = Collect()
    stages = {"work": Apply(lambda x: x * 2), "sink": sink}
    ran = drive(_chain(Policy.BLOCK, 20), stages, {"source": beat(20, 10)}, live=True)
    assert sink.seen == [(n * 10 * MS, 2 * n) for n in range(20)]
    assert ran.seconds > 0.18
    assert balanced(ran.ledger)
    assert all(page["in_flight"] == 0 for page in ran.ledger.values())


def test_a_slow_stage_loses_frames_by_its_policy_and_every_loss_is_counted() -> None:
    stages = {"work": Apply(lambda x: time.sleep(0.035) or x), "sink": Collect()}
    ran = drive(_chain(), stages, {"source": beat(30, 10)}, live=True)
    page = ran.ledger["source/out->work/x"]
    assert page["produced"] == 30
    assert page["delivered"] + page["dropped"]["replaced"] == 30
    assert 1 <= page["delivered"] <= ran.seconds / 0.035 + 1


def test_a_blocking_queue_loses_nothing_and_holds_the_source_back() -> None:
    sink = Collect()
    stages = {"work": Apply(lambda x: time.sleep(0.005) or x), "sink": sink}
    ran = drive(_chain(Policy.BLOCK, 2), stages, {"source": beat(40, 1)}, live=True)
    assert [payload for _, payload in sink.seen] == list(range(40))
    assert ran.ledger["source/out->work/x"]["dropped"] == {}


def test_inline_stages_run_on_the_thread_that_brings_their_trigger() -> None:
    sink = Collect()
    sink.inline = True  # type: ignore[misc]
    nodes = [
        StageNode("source"),
        StageNode("work", (Input("x", (Port("source"),)),), inline=True),
        StageNode("sink", (Input("x", (Port("work"),)),), outputs=(), inline=True),
    ]
    drive(nodes, {"work": Apply(abs), "sink": sink}, {"source": beat(5, 2)}, live=True)
    assert len(sink.seen) == 5
    assert sink.threads == {"src-source"}


def test_a_silent_sensor_does_not_silence_the_graph() -> None:
    died = threading.Event()

    def dies_at_30ms() -> Iterator[Message[int]]:
        yield from beat(4, 10)
        died.set()
        raise OSError("cable pulled")

    def goes_on() -> Iterator[Message[int]]:
        for scan in beat(20, 10):
            if scan.payload == 4:
                died.wait(60)
            yield scan

    nodes = [
        StageNode("lidar"),
        StageNode("camera"),
        StageNode(
            "fuse",
            (
                Input("a", (Port("lidar"),), policy=Policy.BLOCK, size=20),
                Input("b", (Port("camera"),), Sync.NEAREST, tolerance=4 * MS, max_wait=60_000 * MS,
                      missing="proceed"),  # type: ignore[arg-type]
            ),
        ),
        StageNode("sink", (Input("x", (Port("fuse"),), policy=Policy.BLOCK, size=9),), outputs=()),
    ]  # fmt: skip
    sink = Collect()
    sources = {"lidar": goes_on(), "camera": dies_at_30ms()}
    ran = drive(nodes, {"fuse": Pair(), "sink": sink}, sources, live=True)
    assert [payload[0] for _, payload in sink.seen] == list(range(20))
    assert [payload[1] for _, payload in sink.seen] == [0, 1, 2, 3] + [None] * 16
    assert ran.seconds < 30  # nobody waited for it
    assert any("cable pulled" in failure for failure in ran.statistics.failures)


def test_a_failing_stage_stops_and_the_rest_goes_on() -> None:
    def fails_at_3(x: int) -> None:
        if x == 3:
            raise ValueError("three")

    nodes = [
        StageNode("source"),
        StageNode("bad", (_lossless(),), outputs=()),
        StageNode("good", (_lossless(),), outputs=()),
    ]
    good = Collect()
    ran = drive(nodes, {"bad": Apply(fails_at_3), "good": good}, {"source": beat(8, 5)}, live=True)
    assert len(good.seen) == 8
    assert ran.runs["bad"]["failed"] == 1
    assert ran.ledger["source/out->bad/x"]["dropped"] == {"stage_stopped": 4}
    assert ran.scheduler.stopped("bad")


def test_skip_counts_failures_and_goes_on() -> None:
    nodes = [
        StageNode("source"),
        StageNode("bad", (_lossless(),), outputs=(), on_error=OnError.SKIP),
    ]

    def fails_when_odd(x: int) -> None:
        if x % 2:
            raise ValueError("odd")

    ran = drive(nodes, {"bad": Apply(fails_when_odd)}, {"source": beat(8, 5)}, live=True)
    assert ran.runs["bad"]["failed"] == 4
    assert ran.runs["bad"]["finished"] == 4


def test_stop_drains_what_runs_and_ends() -> None:
    sink = Collect()
    stages = {"work": Apply(lambda x: time.sleep(0.05) or x), "sink": sink}
    before = set(threading.enumerate())
    ran = drive(
        _chain(),
        stages,
        {"source": beat(10_000, 5)},
        live=True,
        during=lambda driver: driver.stop(),
    )
    assert ran.seconds < 25  # of the source's 50
    assert balanced(ran.ledger)
    assert ran.runs["work"]["running"] == 0
    for thread in set(threading.enumerate()) - before:
        thread.join(60)  # one that a busy machine does not let end is left behind, and ends later
        assert not thread.is_alive()


def test_a_stage_that_hangs_is_left_behind_and_said_so() -> None:
    hangs, forever = threading.Event(), threading.Event()

    def hang(x: int) -> None:
        hangs.set()
        forever.wait(60)

    def stop(driver: Any) -> None:
        if hangs.is_set():
            driver.stop()

    stages = {"work": Apply(hang), "sink": Collect()}
    ran = drive(_chain(), stages, {"source": beat(6_000, 10)}, live=True, during=stop)
    assert not forever.is_set()  # the run did not wait for it
    forever.set()
    assert ran.seconds < 55  # of the 60 that it hangs
    assert ran.runs["work"]["abandoned"] == 1
    assert any(event.kind == "hung" for event in ran.statistics.events)


def test_a_duration_ends_the_run() -> None:
    stages = {"work": Apply(abs), "sink": Collect()}
    ran = drive(_chain(), stages, {"source": beat(10_000, 5)}, live=True, duration_s=0.3)
    assert 0.25 < ran.seconds < 25  # of the source's 50
