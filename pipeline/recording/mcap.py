"""MCAP files: written so that a crash leaves all but the last chunk, read whole or cut short.

The one file that imports `mcap`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from mcap.reader import SeekingReader
from mcap.records import Channel as McapChannel
from mcap.records import Chunk as McapChunk
from mcap.records import Message as McapMessage
from mcap.records import Schema as McapSchema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from pipeline.errors import DataError
from pipeline.recording.codec import Schema

MAGIC = b"\x89MCAP0\r\n"
#: Chunks of 1 MB: what a crash may cost, about a tenth of a second of a flight with every sensor.
CHUNK_BYTES = 1 << 20
#: What the library raises on damaged bytes: its own errors, and those of struct, zstandard and lz4.
_UNREADABLE = Exception


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic of a file."""

    topic: str
    schema: str  #: its name
    metadata: Mapping[str, str]
    count: int | None  #: messages; None where the file was cut short and must be read to know


@dataclass(frozen=True, slots=True)
class Record:
    """One message as it stands in a file."""

    topic: str
    received: int  #: ns, the file's ``log_time``
    stamp: int  #: ns, the file's ``publish_time``
    seq: int
    data: bytes


@dataclass(slots=True)
class McapWriter:
    """Writes one file; use it in a ``with`` block, whose end writes the index.

    Each chunk is handed to the system as soon as it is full. Raises DataError where the file cannot
    be written.
    """

    path: Path
    _file: IO[bytes] = field(init=False)
    _writer: Writer = field(init=False)
    _channels: dict[str, int] = field(init=False, default_factory=dict)
    _counts: dict[str, int] = field(init=False, default_factory=dict)
    _schemas: dict[str, int] = field(init=False, default_factory=dict)

    def __enter__(self) -> Self:
        try:
            self._file = self.path.open("wb")
        except OSError as error:
            raise DataError(f"cannot write {self.path}: {error.strerror}") from error
        self._writer = Writer(
            self._file,
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.ZSTD,
        )
        self._writer.start(profile="overflight", library="overflight")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
        except OSError as failure:
            raise DataError(f"cannot write {self.path}: {failure.strerror}") from failure
        finally:
            self._file.close()

    def add_channel(
        self, topic: str, schema: Schema, metadata: Mapping[str, str] | None = None
    ) -> None:
        """Declare a topic; a topic is declared once."""
        if schema.name not in self._schemas:
            self._schemas[schema.name] = self._writer.register_schema(
                schema.name, schema.encoding, schema.data
            )
        self._channels[topic] = self._writer.register_channel(
            topic, schema.message_encoding, self._schemas[schema.name], dict(metadata or {})
        )
        self._counts[topic] = 0

    def has_channel(self, topic: str) -> bool:
        """Whether the topic was declared."""
        return topic in self._channels

    def write(self, topic: str, data: bytes, *, received: int, stamp: int) -> None:
        """Append a message to a declared topic."""
        try:
            self._writer.add_message(
                self._channels[topic], received, data, stamp, self._counts[topic]
            )
            self._file.flush()
        except OSError as error:
            raise DataError(f"cannot write {self.path}: {error.strerror}") from error
        self._counts[topic] += 1

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Add a named record of text values: versions, settings."""
        self._writer.add_metadata(name, dict(values))


@dataclass(frozen=True, slots=True)
class McapReader:
    """Reads one file, also one that a crash has cut short.

    Opens the file anew for every walk, so that several threads may read at once. Raises DataError
    where the file cannot be read or is no MCAP file.
    """

    path: Path

    def is_whole(self) -> bool:
        """Whether the file was finished: a file without its end has no index."""
        with self._open() as file:
            file.seek(0, 2)
            if file.tell() < 2 * len(MAGIC):
                return False
            file.seek(-len(MAGIC), 2)
            return file.read() == MAGIC

    def channels(self) -> dict[str, Channel]:
        """The topics by name."""
        if not self.is_whole():
            return {
                channel.topic: Channel(channel.topic, schema, dict(channel.metadata), None)
                for channel, schema in self._scanned_channels()
            }
        with self._open() as file:
            try:
                summary = SeekingReader(file).get_summary()
            except _UNREADABLE as error:
                raise self._damaged(error) from error
        if summary is None:
            raise DataError(f"{self.path}: has no index; record it again")
        counts = summary.statistics.channel_message_counts if summary.statistics else {}
        return {
            channel.topic: Channel(
                channel.topic,
                summary.schemas[channel.schema_id].name if channel.schema_id else "",
                dict(channel.metadata),
                counts.get(channel.id, 0),
            )
            for channel in summary.channels.values()
        }

    def notes(self) -> dict[str, dict[str, str]]:
        """The records of text values, by name; none of a file that was cut short."""
        if not self.is_whole():
            return {}
        with self._open() as file:
            try:
                return {
                    entry.name: dict(entry.metadata)
                    for entry in SeekingReader(file).iter_metadata()
                }
            except _UNREADABLE as error:
                raise self._damaged(error) from error

    def records(self, topics: Collection[str]) -> Iterator[Record]:
        """The messages of some topics in the order of `received`; of a file that was cut short in
        the order of writing, up to its last whole chunk."""
        if not self.is_whole():
            yield from self._scanned_records(topics)
            return
        with self._open() as file:
            try:
                for _, channel, message in SeekingReader(file, validate_crcs=True).iter_messages(
                    topics=list(topics)
                ):
                    yield _record(channel, message)
            except _UNREADABLE as error:
                raise self._damaged(error) from error

    def _open(self) -> IO[bytes]:
        try:
            file = self.path.open("rb")
        except OSError as error:
            raise DataError(f"cannot read {self.path}: {error.strerror}") from error
        if file.read(len(MAGIC)) != MAGIC:
            file.close()
            raise DataError(f"{self.path}: not an MCAP file")
        file.seek(0)
        return file

    def _scan(self) -> Iterator[McapSchema | McapChannel | McapMessage]:
        """Every record up to where the file ends or is broken."""
        with self._open() as file:
            try:
                for record in StreamReader(file, emit_chunks=True).records:
                    if isinstance(record, McapChunk):
                        for inner in breakup_chunk(record, validate_crc=True):
                            if isinstance(inner, McapSchema | McapChannel | McapMessage):
                                yield inner
            except _UNREADABLE:
                return  # what follows was never written whole

    def _scanned_channels(self) -> Iterator[tuple[McapChannel, str]]:
        schemas: dict[int, str] = {}
        for record in self._scan():
            if isinstance(record, McapSchema):
                schemas[record.id] = record.name
            elif isinstance(record, McapChannel):
                yield record, schemas.get(record.schema_id, "")

    def _scanned_records(self, topics: Collection[str]) -> Iterator[Record]:
        channels: dict[int, McapChannel] = {}
        for record in self._scan():
            if isinstance(record, McapChannel):
                channels[record.id] = record
            elif isinstance(record, McapMessage) and channels[record.channel_id].topic in topics:
                yield _record(channels[record.channel_id], record)

    def _damaged(self, error: Exception) -> DataError:
        return DataError(f"{self.path}: damaged ({error}); record or copy it again")


def _record(channel: McapChannel, message: McapMessage) -> Record:
    return Record(
        channel.topic, message.log_time, message.publish_time, message.sequence, message.data
    )
