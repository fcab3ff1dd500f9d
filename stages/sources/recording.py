"""Recorded flights: any topic of an MCAP file as a source, and the calibration that it brings."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import is_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pipeline.errors import DataError
from pipeline.graph.options import import_name
from pipeline.message import Message
from pipeline.recording.codec import PAYLOAD_CLASS
from pipeline.recording.foxglove import schema
from pipeline.recording.mcap import McapReader, McapWriter
from pipeline.stage import Source
from stages.codecs.poses import decode_calibration, encode_camera, encode_mounts
from stages.codecs.registry import PayloadCodecs
from stages.types import Calibration

#: Topics that hold the calibration: the fixed transforms, and one per camera.
MOUNTS = "calibration/mounts"
CAMERAS = "calibration/cameras/"


class Recording(Source):
    """The messages of one topic, as they were recorded.

    Stamps, extents and arrival times are the recording's. A file that a crash has cut short is read
    up to its last whole chunk.
    """

    def __init__(self, *, path: Path, topic: str, payloads: tuple[str, ...] = ()) -> None:
        """`path`: the MCAP file. `topic`: its name in the file. `payloads`: classes of your own
        (module:Class) that it may hold; a file alone never decides what is imported."""
        self.path = path
        self.topic = topic
        self._payloads = [_payload_class(name) for name in payloads]

    def open(self) -> None:
        channels = McapReader(self.path).channels()
        if self.topic not in channels:
            close = get_close_matches(self.topic, channels, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"it has {', '.join(channels)}"
            raise DataError(f"{self.path}: no topic '{self.topic}'; {hint}")
        schema, metadata = channels[self.topic].schema, channels[self.topic].metadata
        codec = PayloadCodecs(self._payloads).reading(schema, metadata)
        if codec is None:
            where = f"{self.path}: topic '{self.topic}' holds"
            if (named := metadata.get(PAYLOAD_CLASS)) is not None:
                raise DataError(
                    f"{where} {named}; say 'payloads: [{named}]' to have it read as that"
                )
            raise DataError(f"{where} {schema}, which is no payload of a stage")
        self._codec = codec

    def last_arrival(self) -> int | None:
        return McapReader(self.path).last_time(self.topic)

    def messages(self) -> Iterator[Message[Any]]:
        for record in McapReader(self.path).records([self.topic]):
            try:
                yield self._codec.decode(record.data, record.received)
            except DataError as error:
                where = f"{self.path}: {self.topic}, message {record.seq}"
                raise DataError(f"{where}: {error}") from error


def _payload_class(name: str) -> type:
    """Raises ValueError for what is none."""
    try:
        found = import_name(name)
    except ImportError as error:
        raise ValueError(f"payloads: {error}") from None
    if not (isinstance(found, type) and is_dataclass(found)):
        raise ValueError(f"payloads: {name} is no dataclass")
    return found


def write_calibration(file: McapWriter, calibration: Calibration) -> None:
    """Give a recording the calibration that `calibration` reads; before its first message."""
    file.add_channel(MOUNTS, schema("FrameTransforms"))
    file.write(MOUNTS, encode_mounts(calibration, 0), received=0, stamp=0)
    for name in calibration.cameras():
        file.add_channel(CAMERAS + name, schema("CameraCalibration"))
        data = encode_camera(name, calibration.camera(name), 0)
        file.write(CAMERAS + name, data, received=0, stamp=0)


def calibration(*, path: Path) -> Calibration:
    """The calibration that a recording brings. Raises DataError."""
    if not path.exists():
        file = os.path.relpath(path)
        raise DataError(
            f"path {file}: no such file; name a recording of yours, or simulate a flight: "
            f"overflight simulate demo -o {file}"
        )
    reader = McapReader(path)
    topics = reader.channels()
    if MOUNTS not in topics:
        raise DataError(
            f"{path}: brings no calibration (topic {MOUNTS}); give one in the graph file"
        )
    cameras = [topic for topic in topics if topic.startswith(CAMERAS)]
    latest = {record.topic: record.data for record in reader.records([MOUNTS, *cameras])}
    if MOUNTS not in latest:
        raise DataError(f"{path}: the calibration was not written before the file was cut short")
    return decode_calibration(latest[MOUNTS], [latest[name] for name in cameras if name in latest])
