"""The recorded messages of several ports, in the order of the flight."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Generator
from typing import Any

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording.channels import topic_of
from pipeline.recording.codec import Codec, Codecs
from pipeline.recording.flight import Flight
from pipeline.recording.mcap import Record
from pipeline.scheduling.topology import Port


class Payloads:
    """Gives each message of some ports once, by port and stamp; both only go forward.

    The file is read once, and only as far as is asked. Raises DataError where a message is missing
    or its bytes are damaged.
    """

    def __init__(self, flight: Flight, ports: Collection[Port], codecs: Codecs) -> None:
        self._path = flight.path
        self._codecs: dict[str, Codec] = {}
        self._waiting: dict[str, deque[Record]] = {}
        for port in ports:
            channel = flight.channels.get(port)
            codec = None
            if channel is not None:
                codec = codecs.reading(channel.schema, channel.metadata)
            if channel is None or codec is None:
                held = "is not in it" if channel is None else f"is a {channel.schema}, unknown here"
                raise DataError(f"{self._path}: the output {port} {held}")
            self._codecs[channel.topic] = codec
            self._waiting[channel.topic] = deque()
        self._records: Generator[Record] = flight.reader.records(list(self._codecs))

    def take(self, port: Port, stamp: int) -> Message[Any]:
        """The message of a port at a stamp."""
        topic = topic_of(port)
        waiting = self._waiting[topic]
        while True:
            record = waiting.popleft() if waiting else next(self._records, None)
            if record is None or (record.topic == topic and record.stamp > stamp):
                raise DataError(
                    f"{self._path}: misses the message of {port} at {stamp / 1e9:.6f} s"
                )
            if record.topic != topic:
                self._waiting[record.topic].append(record)
            elif record.stamp == stamp:
                try:
                    return self._codecs[topic].decode(record.data, record.received)
                except DataError as error:
                    where = f"{self._path}: {port} at {stamp / 1e9:.6f} s"
                    raise DataError(f"{where}: {error}") from error

    def close(self) -> None:
        """Close the file."""
        self._records.close()
