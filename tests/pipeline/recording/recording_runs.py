"""A small graph that runs, its recorder, and codecs of whole numbers, for the tests beside it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording.codec import PAYLOAD, Codec, Schema
from pipeline.recording.manifest import Manifest
from pipeline.recording.mcap import McapReader, McapWriter, Record
from pipeline.recording.recorder import DECISIONS, Recorder
from pipeline.scheduling.topology import Input, Missing, Port, StageNode, Sync, Topology

MS = 1_000_000


class Numbers:
    """The codec of an `int`."""

    schema = Schema("number", "jsonschema", b"{}", "json")

    def encode(self, message: Message[Any]) -> bytes:
        return json.dumps([message.payload, message.stamp]).encode()

    def decode(self, data: bytes, received: int) -> Message[Any]:
        try:
            payload, stamp = json.loads(data)
            return Message.at(int(stamp), int(payload), received=received)
        except (ValueError, TypeError) as error:
            raise DataError(f"damaged number ({error})") from error


class NumberCodecs:
    """Whole numbers only."""

    def writing(self, payload: object) -> Codec:
        if not isinstance(payload, int):
            raise DataError(f"no codec writes {type(payload).__name__} to a recording")
        return Numbers()

    def reading(self, schema: str, metadata: Mapping[str, str]) -> Codec | None:
        return Numbers() if metadata.get(PAYLOAD) == "int" else None


def topology() -> Topology:
    """A trigger, a slower stream that is nearest to it, and a sink."""
    return Topology(
        (
            StageNode("lidar"),
            StageNode("camera"),
            StageNode(
                "fuse",
                (
                    Input("a", (Port("lidar"),)),
                    Input(
                        "b",
                        (Port("camera"),),
                        Sync.NEAREST,
                        tolerance=8 * MS,
                        max_wait=20 * MS,
                        missing=Missing.PROCEED,
                    ),
                ),
            ),
            StageNode("sink", (Input("x", (Port("fuse"),)),), outputs=()),
        )
    )


def manifest(of: Topology, *, offline: bool = False) -> Manifest:
    return Manifest("test", "overflight: 1\n", of, offline, "", "now", {}, {}, {}, {})


def recorder(path: Path, of: Topology, **settings: Any) -> Recorder:
    """A recorder of all ports."""
    ports = [Port(node.name, name) for node in of.stages for name in node.outputs]
    sources = [port for port in ports if of.stage(port.stage).is_source]
    return Recorder(
        path,
        manifest(of),
        NumberCodecs(),
        **{"stored": ports, "sources": sources, "compression": "none", **settings},
    )


def pages(path: Path) -> Iterator[dict[str, Any]]:
    """The decisions of a file, as they stand there."""
    for record in McapReader(path).records([DECISIONS]):
        yield json.loads(record.data)


def rewrite(path: Path, change: Callable[[Record], Record | None]) -> None:
    """Change or leave out records of a file."""
    reader = McapReader(path)
    channels = reader.channels()
    notes = reader.notes()
    records = list(reader.records(list(channels)))
    with McapWriter(path, "none") as file:
        for name, values in notes.items():
            file.note(name, values)
        for channel in channels.values():
            form = Schema(channel.schema, "jsonschema", b"{}", "json")
            file.add_channel(channel.topic, form, channel.metadata)
        for record in records:
            changed = change(record)
            if changed is not None:
                file.write(
                    changed.topic,
                    changed.data,
                    received=changed.received,
                    stamp=changed.stamp,
                    seq=changed.seq,
                )
