"""A recorded run, re-enacted: the same sets, losses and outputs, however fast the machine is."""

from __future__ import annotations

import json
import random
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from driving import Collect, beat, drive
from recording_runs import MS, NumberCodecs, Numbers, recorder, rewrite, topology

from pipeline.drivers.executor import Worker
from pipeline.drivers.replay import ReplayDriver
from pipeline.errors import DataError
from pipeline.measuring.statistics import Statistics
from pipeline.message import Message
from pipeline.recording.flight import Flight
from pipeline.recording.mcap import Record
from pipeline.recording.outline import Outline
from pipeline.recording.payloads import Payloads
from pipeline.recording.recorder import DECISIONS
from pipeline.recording.reenactment import Different
from pipeline.scheduling.events import Observer
from pipeline.scheduling.topology import OnError, Policy, Port, Topology
from pipeline.stage import Stage

SOURCES = (Port("lidar"), Port("camera"))


class Fuse(Stage):
    """Adds what it has seen so far to its inputs: what went before shows in every output."""

    def __init__(
        self, sleep: Callable[[], float] = lambda: 0.0, fails_at: Collection[int] = ()
    ) -> None:
        self._sleep = sleep
        self._fails_at = fails_at
        self._sum = 0

    def process(self, a: Message[int], b: Message[int] | None) -> int:
        time.sleep(self._sleep())
        if a.payload in self._fails_at:
            raise ValueError("spoiled")
        self._sum += a.payload + (1000 * b.payload if b else 0)
        return self._sum


def skipping() -> Topology:
    lidar, camera, fuse, sink = topology().stages
    return Topology((lidar, camera, replace(fuse, on_error=OnError.SKIP), sink))


def keeping() -> Topology:
    """Of which the sink sees all that is fused, however late it is."""
    lidar, camera, fuse, sink = topology().stages
    (trigger,) = sink.inputs
    block = replace(trigger, policy=Policy.BLOCK, size=4)
    return Topology((lidar, camera, fuse, replace(sink, inputs=(block,))))


def record(path: Path, fuse: Fuse, *, live: bool, of: Topology | None = None) -> Collect:
    """Fly half a second of scans and images; what the sink saw."""
    of = of or topology()
    sink = Collect()
    with recorder(path, of) as kept:
        sources = {"lidar": beat(50, 10), "camera": beat(25, 20, delay_ms=5)}
        drive(of.stages, {"fuse": fuse, "sink": sink}, sources, live=live, recorder=kept)
    return sink


class Replayed:
    """A replay with these stages."""

    def __init__(self, path: Path, stages: Mapping[str, Stage], fed: Collection[str] = ()) -> None:
        flight = Flight(path)
        of = flight.manifest.topology
        self.outline = Outline.of(flight, SOURCES)
        workers = {name: Worker(of.stage(name), stage) for name, stage in stages.items()}
        self.statistics = Statistics(offline=False)
        ports = [*SOURCES, *(Port(name) for name in fed)]
        self.driver = ReplayDriver(
            of,
            self.outline,
            workers,
            Payloads(flight, ports, NumberCodecs()),
            fed,
            self.statistics,
            offline=False,
            observer=Observer(),
        )
        with self.statistics.profiler:
            assert self.driver.run(flight.pages(), lambda: None)


@pytest.mark.realtime
def test_a_live_run_under_load_is_repeated_exactly_by_a_faster_machine(tmp_path: Path) -> None:
    dice = random.Random(3)
    slow = Fuse(lambda: dice.choice((0.001, 0.015, 0.03)))
    flown = record(tmp_path / "f", slow, live=True, of=keeping())
    assert 1 < len(flown.seen) < 50, "some scans must be lost, or there is nothing to repeat"
    sink = Collect()
    replayed = Replayed(tmp_path / "f", {"fuse": Fuse(), "sink": sink})
    assert sink.seen == flown.seen
    driver = replayed.driver
    assert (driver.differences, driver.not_compared) == (0, 0)
    assert driver.compared == 75 + len(flown.seen)
    assert driver.events == replayed.outline.events


def test_the_first_output_that_differs_is_named(tmp_path: Path) -> None:
    record(tmp_path / "f", Fuse(), live=False)

    def change(entry: Record) -> Record:
        if entry.topic != "lidar" or entry.seq != 7:
            return entry
        other = Numbers().encode(Message.at(entry.stamp, 1))
        return replace(entry, data=other)

    rewrite(tmp_path / "f", change)
    driver = Replayed(tmp_path / "f", {"fuse": Fuse(), "sink": Collect()}).driver
    assert driver.different[0] == "lidar/out at stamp 0.070000 s (message 7, int)"
    assert driver.different[1] == "fuse/out at stamp 0.070000 s (message 7, int)"
    assert driver.differences == 1 + 43  # all sums from there on


def test_a_stage_that_computes_otherwise_is_found_out(tmp_path: Path) -> None:
    record(tmp_path / "f", Fuse(), live=False)
    fuse = Fuse()
    fuse._sum = 1
    driver = Replayed(tmp_path / "f", {"fuse": fuse, "sink": Collect()}).driver
    assert driver.differences == 50
    assert driver.different[0].startswith("fuse/out at stamp 0.000000 s")


def test_a_decision_that_was_changed_in_the_file_is_named(tmp_path: Path) -> None:
    record(tmp_path / "f", Fuse(), live=False)

    def change(entry: Record) -> Record:
        if entry.topic != DECISIONS:
            return entry
        page = json.loads(entry.data)
        for row in page["rows"]:
            for followed in row[4]:
                if followed[:3] == ["set", "fuse", 80 * MS]:
                    followed[3][1] -= 1  # the image before the one that was taken
        return replace(entry, data=json.dumps(page).encode())

    rewrite(tmp_path / "f", change)
    with pytest.raises(Different, match=r"was set fuse 80000000 .* in the flight and is set f"):
        Replayed(tmp_path / "f", {"fuse": Fuse(), "sink": Collect()})


def test_a_stage_that_is_fed_is_not_executed(tmp_path: Path) -> None:
    flown = record(tmp_path / "f", Fuse(), live=False)
    sink = Collect()
    driver = Replayed(tmp_path / "f", {"sink": sink}, fed=["fuse"]).driver
    assert sink.seen == flown.seen
    assert (driver.differences, driver.compared) == (0, 125)


def test_a_failure_is_repeated_or_told(tmp_path: Path) -> None:
    flown = record(tmp_path / "f", Fuse(fails_at=[5]), live=False, of=skipping())
    assert len(flown.seen) == 49
    for fails_at, kind in (([5], "failed_again"), ([], "not_repeated")):
        sink = Collect()
        replayed = Replayed(tmp_path / "f", {"fuse": Fuse(fails_at=fails_at), "sink": sink})
        assert [event.kind for event in replayed.statistics.events] == [kind]
        assert [stamp for stamp, _ in sink.seen] == [stamp for stamp, _ in flown.seen]
    with pytest.raises(DataError, match=r"fuse failed at stamp 0.090000 s, which it did not"):
        Replayed(tmp_path / "f", {"fuse": Fuse(fails_at=[5, 9]), "sink": Collect()})


def test_a_lost_message_of_a_sensor_is_the_gap_that_is_named(tmp_path: Path) -> None:
    of = topology()
    with recorder(tmp_path / "f", of, buffer_bytes=30_500) as kept:
        scheduler = kept.scheduler(of, offline=True)
        for number in range(40):  # nobody writes meanwhile
            scheduler.publish(Port("lidar"), Message.at(number * MS, number), number * MS)
    gap = Outline.of(Flight(tmp_path / "f"), SOURCES).gap
    assert gap == (
        "the message of lidar/out at 0.030000 s was lost: the recorder's buffer was full"
    )
    assert Outline.of(Flight(tmp_path / "f"), SOURCES[1:]).gap is None


def test_missing_decisions_are_the_gap_that_is_named(tmp_path: Path) -> None:
    record(tmp_path / "f", Fuse(), live=False)

    def change(entry: Record) -> Record:
        if entry.topic != DECISIONS:
            return entry
        page = json.loads(entry.data)
        page["rows"] = [row for row in page["rows"] if row[0] not in (31, 32)]
        return replace(entry, data=json.dumps(page).encode())

    rewrite(tmp_path / "f", change)
    gap = Outline.of(Flight(tmp_path / "f"), SOURCES).gap
    assert gap is not None
    assert gap.startswith("2 decisions were lost between")


def test_a_message_that_is_missing_from_its_topic_is_named(tmp_path: Path) -> None:
    record(tmp_path / "f", Fuse(), live=False)

    def change(entry: Record) -> Any:
        return None if (entry.topic, entry.seq) == ("camera", 3) else entry

    rewrite(tmp_path / "f", change)
    with pytest.raises(DataError, match=r"misses the message of camera/out at 0.060000 s"):
        Replayed(tmp_path / "f", {"fuse": Fuse(), "sink": Collect()})
