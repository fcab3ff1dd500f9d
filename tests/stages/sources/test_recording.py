"""A recorded topic as a source."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording.codec import PAYLOAD, Schema
from pipeline.recording.mcap import McapWriter
from stages.codecs.poses import encode_mounts
from stages.codecs.registry import codec_of
from stages.sources.recording import MOUNTS, Recording, calibration
from stages.types import Calibration, Pose, SensorCalibration


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    """Five poses, and a topic that no stage reads."""
    path = tmp_path / "flight.mcap"
    with McapWriter(path) as file:
        codec = codec_of(Pose(np.eye(4)))
        file.add_channel("pose", codec.schema, {PAYLOAD: "Pose"})
        file.add_channel("log", Schema("foxglove.Log", "protobuf", b"", "protobuf"))
        for k in range(5):
            sent = Message.at(10 * k, Pose(np.eye(4) * [1, 1, 1, 1]))
            file.write("pose", codec.encode(sent), received=10 * k + 4, stamp=10 * k)
        file.write("log", b"hello", received=60, stamp=60)
    return path


def test_a_source_gives_the_recorded_messages(flight: Path) -> None:
    source = Recording(path=flight, topic="pose")
    source.open()
    messages = list(source.messages())
    assert [message.stamp for message in messages] == [0, 10, 20, 30, 40]
    assert [message.received for message in messages] == [4, 14, 24, 34, 44]
    assert all(isinstance(message.payload, Pose) for message in messages)


def test_a_recording_knows_when_it_ends_and_one_that_was_cut_short_does_not(flight: Path) -> None:
    source = Recording(path=flight, topic="pose")
    source.open()
    last = source.last_arrival()
    assert last is not None
    assert 44 <= last <= 60  # to the chunk, which holds a line of the log as well
    flight.write_bytes(flight.read_bytes()[:-20])
    assert source.last_arrival() is None


@pytest.mark.parametrize(
    ("topic", "told"),
    [("pos", "did you mean 'pose'"), ("thermal", "it has"), ("log", "no payload of a stage")],
)
def test_a_topic_that_cannot_be_read_is_told_when_the_source_opens(
    flight: Path, topic: str, told: str
) -> None:
    with pytest.raises(DataError, match=told):
        Recording(path=flight, topic=topic).open()


def test_a_damaged_message_is_named(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    with McapWriter(path) as file:
        file.add_channel("pose", codec_of(Pose(np.eye(4))).schema)
        file.write("pose", b"\xff\xff\xff", received=0, stamp=0)
    source = Recording(path=path, topic="pose")
    source.open()
    with pytest.raises(DataError, match=r"flight\.mcap: pose, message 0: damaged pose"):
        list(source.messages())


def test_a_recording_brings_its_calibration(tmp_path: Path, flight: Path) -> None:
    path = tmp_path / "with.mcap"
    mount = np.eye(4)
    mount[:3, 3] = 0.1, 0.2, 0.3
    with McapWriter(path) as file:
        file.add_channel(MOUNTS, Schema("foxglove.FrameTransforms", "protobuf", b"", "protobuf"))
        brought = Calibration({"lidar": SensorCalibration(mount)})
        file.write(MOUNTS, encode_mounts(brought, 0), received=0, stamp=0)
    assert calibration(path=path).sensor("lidar").base_from_sensor == pytest.approx(mount)
    with pytest.raises(DataError, match="brings no calibration"):
        calibration(path=flight)
    with pytest.raises(DataError, match=r"path none\.mcap: no such file; .* simulate demo -o none"):
        calibration(path=Path("none.mcap"))
