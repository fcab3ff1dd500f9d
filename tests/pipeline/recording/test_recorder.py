"""A recorder keeps what fits, names what does not, and outlives its disk."""

from __future__ import annotations

import logging
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from driving import Collect, Pair, beat, drive
from recording_runs import MS, Numbers, pages, recorder, topology

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording.manifest import NOTE, Manifest
from pipeline.recording.mcap import McapReader
from pipeline.recording.recorder import DECISIONS
from pipeline.scheduling.topology import Port

LIDAR, CAMERA = Port("lidar"), Port("camera")


def fly(path: Path, **settings: Any) -> dict[str, Any]:
    """Record an offline run of 20 scans and 10 images; the recorder's statistics."""
    of = topology()
    stages = {"fuse": Pair(), "sink": Collect()}
    sources = {"lidar": beat(20, 10), "camera": beat(10, 20)}
    with recorder(path, of, **settings) as kept:
        drive(of.stages, stages, sources, live=False, recorder=kept)
    return kept.statistics()


def test_messages_hashes_and_decisions_are_in_the_file(tmp_path: Path) -> None:
    statistics = fly(tmp_path / "f.mcap")
    assert statistics["messages"] == {"lidar/out": 20, "camera/out": 10}
    assert statistics["lost_no_codec"] == {"fuse/out": 20}  # tuples
    reader = McapReader(tmp_path / "f.mcap")
    channel = reader.channels()["lidar"]
    assert channel.metadata == {
        **{"payload": "int", "class": "builtins:int"},
        **{"port": "lidar/out", "lossless": "true"},
    }
    scans = [Numbers().decode(record.data, 0) for record in reader.records(["lidar"])]
    assert [(scan.stamp, scan.payload) for scan in scans] == [(n * 10 * MS, n) for n in range(20)]
    found = list(pages(tmp_path / "f.mcap"))
    rows = [row for page in found for row in page["rows"]]
    assert [row[0] for row in rows] == list(range(len(rows)))
    hashes = {tuple(entry[:3]) for page in found for entry in page["hashes"]}
    assert hashes >= {("lidar", "out", n) for n in range(20)} | {("fuse", "out", 19)}
    lost = [entry for page in found for entry in page["lost"]]
    assert lost[0] == ["fuse", "out", 0, 0, "no codec writes tuple to a recording"]
    assert Manifest.of(reader.notes()).topology == topology()


def test_what_finds_the_buffer_full_is_counted_and_named_and_sensors_have_half_of_it_alone(
    tmp_path: Path,
) -> None:
    kept = recorder(tmp_path / "f.mcap", topology(), buffer_bytes=10_000)
    with kept:
        for number in range(12):
            for port in (LIDAR, Port("fuse")):
                kept.message(port, Message.at(number, number))
    statistics = kept.statistics()
    assert statistics["messages"] == {"lidar/out": 8, "fuse/out": 2}
    assert statistics["lost_buffer_full"] == {"fuse/out": 10, "lidar/out": 4}


def test_a_disk_that_gets_full_ends_the_recording_and_not_the_flight(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    of = topology()
    sink = Collect()
    with caplog.at_level(logging.WARNING), recorder(tmp_path / "f.mcap", of) as kept:
        full = os.open("/dev/full", os.O_WRONLY)
        os.dup2(full, kept.file._file.fileno())  # from here on the system has no space
        os.close(full)
        sources = {"lidar": beat(200, 10), "camera": beat(100, 20)}
        stages = {"fuse": Pair(), "sink": sink}
        drive(of.stages, stages, sources, live=False, recorder=kept)
    assert len(sink.seen) == 200
    assert "No space left on device" in str(kept.statistics()["ended_early"])
    assert caplog.messages[-1].startswith("the recording ends here, the flight goes on")
    assert list(McapReader(tmp_path / "f.mcap").records(["lidar"])) == []


def test_a_disk_that_is_full_is_told_before_the_flight() -> None:
    with pytest.raises(DataError, match="No space left"), recorder(Path("/dev/full"), topology()):
        pass


def test_a_limit_of_the_file_size_leaves_what_was_written_whole(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    of = topology()
    with recorder(tmp_path / "f.mcap", of) as kept:
        scheduler = kept.scheduler(of, offline=True)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
        try:
            for number in range(5_000):
                scheduler.publish(LIDAR, Message.at(number, number), number)
                if number % 50 == 49 and kept.statistics()["ended_early"] is None:
                    kept.write_now()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "File too large" in str(kept.statistics()["ended_early"])
    reader = McapReader(tmp_path / "f.mcap")
    assert not reader.is_whole()
    assert len(list(reader.records(["lidar"]))) > 100


@pytest.mark.realtime
@pytest.mark.slow
def test_a_killed_process_leaves_all_but_the_last_seconds(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    here = Path(__file__)
    program = f"""
import sys; sys.path[:0] = [{str(here.parent)!r}, {str(here.parents[1] / "drivers")!r}]
from pathlib import Path
from test_recorder import fly_live
fly_live(Path({str(path)!r}))
"""
    process = subprocess.Popen([sys.executable, "-c", program], cwd=here.parents[3])
    try:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and (
            not path.exists()
            or path.stat().st_size < 1000
            or len(list(McapReader(path).records(["lidar"]))) < 150
        ):
            time.sleep(0.1)
        os.kill(process.pid, signal.SIGKILL)
    finally:
        process.kill()
        process.wait()
    reader = McapReader(path)
    assert not reader.is_whole()
    assert reader.notes()[NOTE]["graph"] == "test"
    numbers = [record.seq for record in reader.records(["lidar"])]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) >= 150
    assert list(reader.records([DECISIONS]))


def fly_live(path: Path) -> None:
    """Record a minute of a live run."""
    of = topology()
    sources: dict[str, Iterator[Message[Any]]] = {"lidar": beat(6000, 10), "camera": beat(3000, 20)}
    with recorder(path, of) as kept:
        stages = {"fuse": Pair(), "sink": Collect()}
        drive(of.stages, stages, sources, live=True, recorder=kept)
