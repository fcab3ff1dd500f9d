"""The topics of a recorded run: each port's messages under one name, and which of them are exact.

A port's topic is its stage's name where it is the stage's only output, else ``stage/port``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording.codec import PAYLOAD, PAYLOAD_CLASS, Codec, Codecs
from pipeline.recording.digest import digest_of
from pipeline.recording.mcap import McapWriter
from pipeline.scheduling.topology import Port
from pipeline.transport.schema import class_name

#: Keys of a channel's metadata: the port it holds, and whether payloads come back bit by bit.
PORT, LOSSLESS = "port", "lossless"


def topic_of(port: Port) -> str:
    """What a port's messages are called in a file."""
    return port.stage if port.name == "out" else str(port)


@dataclass(frozen=True, slots=True)
class _Channel:
    payload: type
    codec: Codec


class Channels:
    """Writes messages by port; each port gets its topic and its codec with its first message."""

    def __init__(self, file: McapWriter, codecs: Codecs) -> None:
        self._file = file
        self._codecs = codecs
        self._known: dict[Port, _Channel] = {}

    def write(self, port: Port, message: Message[Any], digest: str | None) -> None:
        """Write a message. Raises DataError where no codec or no file takes it."""
        channel = self._known.get(port)
        if channel is None:
            channel = self._known[port] = self._open(port, message, digest)
        if type(message.payload) is not channel.payload:
            raise DataError(
                f"a {type(message.payload).__name__} after {channel.payload.__name__}s; a topic "
                "holds one type"
            )
        data = channel.codec.encode(message)
        self._file.write(
            topic_of(port), data, received=message.received, stamp=message.stamp, seq=message.seq
        )

    def _open(self, port: Port, message: Message[Any], digest: str | None) -> _Channel:
        codec = self._codecs.writing(message.payload)
        again = codec.decode(codec.encode(message), message.received)
        exact = digest is not None and digest_of(again.payload) == digest
        metadata = {
            PAYLOAD: type(message.payload).__name__,
            PAYLOAD_CLASS: class_name(type(message.payload)),
            PORT: str(port),
            LOSSLESS: "true" if exact else "false",
        }
        self._file.add_channel(topic_of(port), codec.schema, metadata)
        return _Channel(type(message.payload), codec)
