"""What travels beside a payload: a message's times and lineage, the stream's bound, and numbers.

Packed with `struct`, about 100 bytes and some per sample of the lineage: an 8-byte payload costs
what Zenoh costs. Whatever is not exactly an envelope of this version raises WireError.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Any, NamedTuple

from pipeline.errors import WireError
from pipeline.message import Message, Sample

MAGIC = b"OVF"
#: Raised with every change of the envelope or of the codec; both ends must have the same.
VERSION = 1
#: The bound of a stream of which nothing is known: below every stamp.
NO_BOUND = -(1 << 62)
#: Samples in one lineage; a fused cloud has some ten.
MAX_SAMPLES = 4096

_FIXED = struct.Struct("<3sBBBHQQQqqqqqqIQQ")
_SLOT = struct.Struct("<IQ")
_SAMPLE = struct.Struct("<qq")
_LENGTH = struct.Struct("<H")

_DEGRADED, _EXECUTOR, _RING, _ZSTD = 1, 2, 4, 8
_FLAGS = _DEGRADED | _EXECUTOR | _RING | _ZSTD


class Kind(IntEnum):
    """What an envelope says."""

    HELLO = 0  #: the publisher is there; nothing else is known
    MESSAGE = 1  #: a payload comes with it
    BOUND = 2  #: nothing below `bound` will come
    RELEASED = 3  #: the run at `stamp` gave nothing, and the bound went past it
    END = 4  #: nothing will come any more


_KINDS = tuple(Kind)


class Slot(NamedTuple):
    """Where a payload lies in shared memory."""

    file: str  #: a name in /dev/shm, without a folder
    at: int  #: of the file's slots, from 0
    generation: int


class Place(NamedTuple):
    """How a payload travels: filled in by the transport."""

    header: int = 0  #: bytes of the codec's header, which come first
    size: int = 0  #: bytes of the buffers
    stored: int = 0  #: bytes of the buffers as they travel: less where compressed
    slot: Slot | None = None  #: None: after the header
    zstd: bool = False


# Tuples, not frozen dataclasses: one is made at each end of every hop, in a tenth of the time.
class Envelope(NamedTuple):
    """The fields of a `Message` but its payload, and the publisher's bound after it."""

    kind: Kind
    port: str  #: ``stage/port``
    bound: int  #: the lowest stamp that may still come, ns
    stamp: int = 0
    begin: int = 0
    end: int = 0
    received: int = 0
    seq: int = 0  #: of the message on its port
    lineage: tuple[Sample, ...] = ()
    executor: str | None = None
    degraded: bool = False
    # Filled in by the transport:
    schema: int = 0  #: hash of the payload's classes
    epoch: int = 0  #: a life of the publisher; a later one is greater
    number: int = 0  #: of the message on this channel in this epoch; else: of the next message
    place: Place = Place()

    @classmethod
    def of(cls, message: Message[Any], port: str, bound: int) -> Envelope:
        """The envelope of a message that its port has taken."""
        return cls(
            Kind.MESSAGE,
            port,
            bound,
            message.stamp,
            message.begin,
            message.end,
            message.received,
            message.seq,
            message.lineage,
            message.executor,
            message.degraded,
        )

    def message(self, payload: Any) -> Message[Any]:
        """The message again, as its publisher's port took it."""
        return Message(
            payload,
            self.stamp,
            self.begin,
            self.end,
            self.received,
            self.seq,
            self.lineage,
            self.executor,
            self.degraded,
        )


def pack(envelope: Envelope) -> bytes:
    """The envelope as bytes. Raises WireError where a field is out of range."""
    place, slot, executor = envelope.place, envelope.place.slot, envelope.executor
    flags = (
        _DEGRADED * envelope.degraded
        | (0 if executor is None else _EXECUTOR)
        | (0 if slot is None else _RING)
        | _ZSTD * place.zstd
    )
    if len(envelope.lineage) > MAX_SAMPLES:
        raise WireError(
            "oversized",
            f"{envelope.port}: a lineage of {len(envelope.lineage)} samples; {MAX_SAMPLES} travel",
        )
    try:
        parts = [
            _FIXED.pack(
                MAGIC,
                VERSION,
                envelope.kind,
                flags,
                len(envelope.lineage),
                envelope.schema,
                envelope.epoch,
                envelope.number,
                envelope.stamp,
                envelope.begin,
                envelope.end,
                envelope.received,
                envelope.bound,
                envelope.seq,
                place.header,
                place.size,
                place.stored,
            ),
            _text(envelope.port),
        ]
        if executor is not None:
            parts.append(_text(executor))
        if slot is not None:
            parts += [_text(slot.file), _SLOT.pack(slot.at, slot.generation)]
        for stream, stamp, received in envelope.lineage:
            parts += [_text(stream), _SAMPLE.pack(stamp, received)]
    except (struct.error, UnicodeEncodeError) as error:
        raise WireError("malformed", f"{envelope.port}: a field cannot travel: {error}") from None
    return b"".join(parts)


def unpack(data: bytes) -> Envelope:
    """The envelope that `data` is, to the last byte. Raises WireError."""
    if data[:3] != MAGIC or len(data) < 4:
        raise WireError("malformed", "what arrived is no message of Overflight; check the endpoint")
    if data[3] != VERSION:
        raise WireError(
            "version",
            f"the other side speaks version {data[3]} of the wire format, this one {VERSION}; "
            "install the same version of Overflight on both",
        )
    try:
        return _unpack(data)
    except (struct.error, UnicodeDecodeError, ValueError) as error:
        raise WireError("malformed", f"an envelope is cut short or damaged: {error}") from None


def _unpack(data: bytes) -> Envelope:
    _, _, kind, flags, samples, schema, epoch, number, *times, header, size, stored = (
        _FIXED.unpack_from(data)
    )
    stamp, begin, end, received, bound, seq = times
    if kind >= len(_KINDS) or flags & ~_FLAGS or samples > MAX_SAMPLES:
        raise ValueError(f"kind {kind}, flags {flags:#x}, {samples} samples")
    at = _FIXED.size
    port, at = _read_text(data, at)
    executor = slot = None
    if flags & _EXECUTOR:
        executor, at = _read_text(data, at)
    if flags & _RING:
        file, at = _read_text(data, at)
        slot = Slot(file, *_SLOT.unpack_from(data, at))
        at += _SLOT.size
    lineage = []
    for _ in range(samples):
        stream, at = _read_text(data, at)
        lineage.append(Sample(stream, *_SAMPLE.unpack_from(data, at)))
        at += _SAMPLE.size
    if at != len(data):
        raise ValueError(f"{len(data) - at} bytes after its end")
    return Envelope(
        _KINDS[kind],
        port,
        bound,
        stamp,
        begin,
        end,
        received,
        seq,
        tuple(lineage),
        executor,
        bool(flags & _DEGRADED),
        schema,
        epoch,
        number,
        Place(header, size, stored, slot, bool(flags & _ZSTD)),
    )


def _text(text: str) -> bytes:
    encoded = text.encode()
    return _LENGTH.pack(len(encoded)) + encoded


def _read_text(data: bytes, at: int) -> tuple[str, int]:
    (length,) = _LENGTH.unpack_from(data, at)
    at += _LENGTH.size
    if at + length > len(data):
        raise ValueError(f"{at + length - len(data)} bytes of a text are missing")
    return data[at : at + length].decode(), at + length
