"""MCAP files: written so that a crash leaves all but the last chunk, read whole or cut short.

The one file that imports `mcap`.
"""

from __future__ import annotations

import contextlib
import heapq
import zlib
from collections.abc import Collection, Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Literal, Self

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.reader import SeekingReader
from mcap.records import Attachment as McapAttachment
from mcap.records import Channel as McapChannel
from mcap.records import Chunk as McapChunk
from mcap.records import ChunkIndex
from mcap.records import Message as McapMessage
from mcap.records import Metadata as McapMetadata
from mcap.records import Schema as McapSchema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary
from mcap.writer import CompressionType, Writer

from pipeline.errors import DataError
from pipeline.recording.codec import Schema

MAGIC = b"\x89MCAP0\r\n"
#: Chunks of 1 MB: what a crash may cost, about a tenth of a second of a flight with every sensor.
CHUNK_BYTES = 1 << 20
#: No record and no unpacked chunk is read beyond it: damaged bytes must not ask for all memory.
MAX_RECORD_BYTES = 1 << 28
#: What the library raises on damaged bytes: its own errors, and those of struct, zstandard and lz4.
_UNREADABLE = Exception

#: What a walk through a file tells of.
_Scanned = McapSchema | McapChannel | McapMessage | McapMetadata | McapAttachment

Compression = Literal["zstd", "lz4", "none"]
_COMPRESSIONS: Mapping[Compression, CompressionType] = {
    "zstd": CompressionType.ZSTD,
    "lz4": CompressionType.LZ4,
    "none": CompressionType.NONE,
}


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
    compression: Compression = "zstd"
    broken: bool = field(init=False, default=False)  #: the system refused to write
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
            compression=_COMPRESSIONS[self.compression],
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
            self._file.close()
        except OSError as failure:
            raise self._failed(failure) from failure
        finally:
            self.leave()

    def leave(self) -> None:
        """Close the file as it is, without an index: what was written whole can be read."""
        with contextlib.suppress(OSError):  # of what a full disk keeps from being flushed
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

    def write(
        self, topic: str, data: bytes, *, received: int, stamp: int, seq: int | None = None
    ) -> None:
        """Append a message to a declared topic; without `seq` they are counted from 0."""
        number = self._counts[topic] if seq is None else seq
        try:
            self._writer.add_message(self._channels[topic], received, data, stamp, number)
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from error
        self._counts[topic] += 1

    def flush(self) -> None:
        """End the chunk at hand and give it to the system: a crash cannot take it any more."""
        try:
            self._writer.flush()  # type: ignore[no-untyped-call]
        except OSError as error:
            raise self._failed(error) from error

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Add a named record of text values: versions, settings."""
        try:
            self._writer.add_metadata(name, dict(values))
        except OSError as error:
            raise self._failed(error) from error

    def attach(self, name: str, data: bytes) -> None:
        """Add a whole file of another kind."""
        try:
            self._writer.add_attachment(0, 0, name, "application/octet-stream", data)
        except OSError as error:
            raise self._failed(error) from error

    def _failed(self, error: OSError) -> DataError:
        self.broken = True
        return DataError(f"cannot write {self.path}: {error.strerror}")


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
            summary = self._summary(file)
        counts = summary.statistics.channel_message_counts if summary.statistics else {}
        return {
            channel.topic: Channel(
                channel.topic,
                schema.name if (schema := summary.schemas.get(channel.schema_id)) else "",
                dict(channel.metadata),
                counts.get(channel.id, 0),
            )
            for channel in summary.channels.values()
        }

    def last_time(self, topic: str) -> int | None:
        """The time until which the file has messages of a topic, to a chunk; None without one, or
        where the file was cut short and must be read to know."""
        if not self.is_whole():
            return None
        with self._open() as file:
            summary = self._summary(file)
        numbers = {one.id for one in summary.channels.values() if one.topic == topic}
        ends = (
            chunk.message_end_time
            for chunk in summary.chunk_indexes
            if numbers & chunk.message_index_offsets.keys()
        )
        return max(ends, default=None)

    def notes(self) -> dict[str, dict[str, str]]:
        """The records of text values, by name; of a file that was cut short those that it has."""
        if not self.is_whole():
            found = (record for record in self._scan() if isinstance(record, McapMetadata))
            return {entry.name: dict(entry.metadata) for entry in found}
        with self._open() as file:
            try:
                reader = SeekingReader(file, record_size_limit=MAX_RECORD_BYTES)
                return {entry.name: dict(entry.metadata) for entry in reader.iter_metadata()}
            except _UNREADABLE as error:
                raise self._damaged(error) from error

    def attachments(self) -> Iterator[tuple[str, bytes]]:
        """The files in it, by name."""
        if not self.is_whole():
            yield from ((r.name, r.data) for r in self._scan() if isinstance(r, McapAttachment))
            return
        with self._open() as file:
            try:
                reader = SeekingReader(file, record_size_limit=MAX_RECORD_BYTES)
                yield from ((found.name, found.data) for found in reader.iter_attachments())
            except _UNREADABLE as error:
                raise self._damaged(error) from error

    def records(self, topics: Collection[str]) -> Generator[Record]:
        """The messages of some topics in the order of `received`; of a file that was cut short in
        the order of writing, up to its last whole chunk."""
        if not self.is_whole():
            yield from self._scanned_records(topics)
            return
        with self._open() as file:
            summary = self._summary(file)
            names = {number: channel.topic for number, channel in summary.channels.items()}
            wanted = {number for number, topic in names.items() if topic in topics}
            try:
                for message in _in_order(file, summary.chunk_indexes, wanted):
                    yield _record(names[message.channel_id], message)
            except _UNREADABLE as error:
                raise self._damaged(error) from error

    def _summary(self, file: IO[bytes]) -> Summary:
        try:
            summary = SeekingReader(file, record_size_limit=MAX_RECORD_BYTES).get_summary()
        except _UNREADABLE as error:
            raise self._damaged(error) from error
        if summary is None:
            raise DataError(f"{self.path}: has no index; record it again")
        return summary

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

    def _scan(self) -> Iterator[_Scanned]:
        """Every record up to where the file ends or is broken."""
        with self._open() as file:
            try:
                reader = StreamReader(file, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES)
                for record in reader.records:
                    inside = _unpacked(record) if isinstance(record, McapChunk) else (record,)
                    for inner in inside:
                        if isinstance(inner, _Scanned):
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
            elif isinstance(record, McapMessage):
                channel = channels.get(record.channel_id)
                if channel is not None and channel.topic in topics:
                    yield _record(channel.topic, record)

    def _damaged(self, error: Exception) -> DataError:
        return DataError(f"{self.path}: damaged ({error}); record or copy it again")


def _record(topic: str, message: McapMessage) -> Record:
    return Record(topic, message.log_time, message.publish_time, message.sequence, message.data)


def _in_order(
    file: IO[bytes], indexes: Iterable[ChunkIndex], wanted: Collection[int]
) -> Iterator[McapMessage]:
    """The messages of some channels by their time, from chunks whose times may overlap."""
    held: list[tuple[int, int, McapMessage]] = []
    number = 0
    for index in sorted(indexes, key=lambda one: one.message_start_time):
        if index.message_index_offsets and not wanted & index.message_index_offsets.keys():
            continue
        while held and held[0][0] < index.message_start_time:
            yield heapq.heappop(held)[-1]
        file.seek(index.chunk_start_offset + 1 + 8)
        for record in _unpacked(McapChunk.read(ReadDataStream(file))):
            if isinstance(record, McapMessage) and record.channel_id in wanted:
                heapq.heappush(held, (record.log_time, number, record))
                number += 1
    while held:
        yield heapq.heappop(held)[-1]


def _unpacked(chunk: McapChunk) -> Iterable[object]:
    """The records of a chunk, whose sum is right and whose size is what it says and bounded."""
    size = chunk.uncompressed_size
    if size > MAX_RECORD_BYTES:
        raise ValueError(f"a chunk of {size} bytes")
    data = chunk.data
    if chunk.compression == "zstd":
        frame = zstandard.get_frame_parameters(data)
        if frame.content_size != size:
            raise ValueError("a chunk of another size than it says")
        data = zstandard.decompress(data, max_output_size=size)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size)
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise ValueError("a chunk of another content than it says")
    return breakup_chunk(
        McapChunk(
            compression="",
            data=data,
            message_start_time=chunk.message_start_time,
            message_end_time=chunk.message_end_time,
            uncompressed_crc=0,
            uncompressed_size=size,
        )
    )
