"""The receiving end of a channel, whatever carries its bytes: nothing that arrives can hurt it."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import zstandard

from pipeline.errors import WireError
from pipeline.transport.channel import Arrival, Channel, ChannelStatistics, Refused
from pipeline.transport.codec import HEADER_BYTES, Bytes, Decoder
from pipeline.transport.envelope import Envelope, Kind, Place, Slot, unpack
from pipeline.transport.numbering import Numbering
from pipeline.transport.ring import Reading, RingReader
from pipeline.transport.shared_files import FOLDER


class Inlet:
    """Checks, decodes and counts what arrives on one channel. Used by one thread."""

    def __init__(
        self, channel: Channel, on_arrival: Callable[[Arrival], None], *, folder: Path = FOLDER
    ) -> None:
        self._channel = channel
        self._on_arrival = on_arrival
        self._numbering = Numbering()
        self._ring = RingReader(folder)
        self._decoder = Decoder(channel.schema)
        self._unreadable = 0  #: messages that came, but not their payload
        self._untold = 0  #: losses that no arrival has told yet
        self._received = self._bytes = 0
        self._refused: Counter[str] = Counter()
        self._last_refusal: str | None = None

    def take(self, head: bytes, size: int, body: Callable[[], bytes]) -> None:
        """What arrived: an envelope, and how to get the `size` bytes beside it.

        Calls `on_arrival`; what is not fit for it is counted and dropped.
        """
        try:
            arrival = self._arrival(head, size, body)
        except WireError as error:
            self._last_refusal = f"{self._channel.key}: {error}"  # first: who sees the count has it
            self._refused[error.reason] += 1
            return
        if arrival is not None:
            self._on_arrival(arrival)

    def statistics(self) -> ChannelStatistics:
        return ChannelStatistics(
            received=self._received,
            lost=self._numbering.lost + self._unreadable,
            missed_before=self._numbering.missed_before,
            refused=dict(self._refused),
            last_refusal=self._last_refusal,
            bytes=self._bytes,
        )

    def close(self) -> None:
        self._ring.close()

    def _arrival(self, head: bytes, size: int, body: Callable[[], bytes]) -> Arrival | None:
        envelope = unpack(head)
        self._check(envelope, size)
        slot = envelope.place.slot
        # Before its number counts: what is gone from its slot may have been announced in vain and
        # come again. If not, the next number tells that it is lost.
        reading = None if slot is None else self._reading(slot)
        if reading is not None and reading.withdrawn:
            return None
        is_message = envelope.kind is Kind.MESSAGE
        count = self._numbering.message if is_message else self._numbering.news
        self._untold += count(envelope.epoch, envelope.number, time.monotonic_ns())
        payload = self._payload(envelope.place, reading, body) if is_message else None
        lost, self._untold = self._untold, 0
        return Arrival(envelope, payload, lost)

    def _check(self, envelope: Envelope, size: int) -> None:
        channel, place = self._channel, envelope.place
        if envelope.port != channel.port:
            raise WireError(
                Refused.CHANNEL, f"a message of {envelope.port[:80]} came where {channel.port} does"
            )
        if envelope.schema != channel.schema.hash:
            raise WireError(
                Refused.SCHEMA,
                f"made with other payload classes (schema {envelope.schema:016x}) than "
                f"{channel.schema}; run both sides with the same graph file and code",
            )
        if place.header > HEADER_BYTES or max(place.size, place.stored) > channel.max_bytes:
            raise WireError(
                Refused.OVERSIZED,
                f"{place.header} + {max(place.size, place.stored)} bytes; at most {HEADER_BYTES} + "
                f"{channel.max_bytes} are taken (max_bytes of the edge)",
            )
        beside = place.header + place.stored  # nothing where there is a slot, which has it all
        if size != beside or (place.stored != place.size and not place.zstd):
            raise WireError(Refused.MALFORMED, f"{size} bytes came of {beside}; cut short?")

    def _payload(self, place: Place, reading: Reading | None, body: Callable[[], bytes]) -> Any:
        """The payload of a message that is counted already: lost where it cannot be read."""
        try:
            if reading is not None:
                header, data = reading.header, reading.data
            else:
                header, data = _beside(place, body())
            payload = self._restored(self._decoder.decode(header, data))
        except WireError:
            self._unreadable += 1
            self._untold += 1
            raise
        self._received += 1
        self._bytes += len(header) + len(data)
        return payload

    def _restored(self, payload: Any) -> Any:
        if self._channel.compressor is None:
            return payload
        try:
            return self._channel.compressor.restore(payload)
        except ValueError as error:
            raise WireError(Refused.MALFORMED, f"cannot be decompressed: {error}") from None

    def _reading(self, slot: Slot) -> Reading:
        try:
            reading = self._ring.read(slot)
        except (OSError, ValueError) as error:
            raise WireError(Refused.MALFORMED, f"no such shared memory: {error}") from None
        if reading is None:
            raise WireError(
                Refused.GONE,
                f"{slot.file} slot {slot.at} holds a newer message; read faster, or give the "
                "edge more slots",
            )
        if len(reading.data) > self._channel.max_bytes:
            raise WireError(Refused.OVERSIZED, f"{len(reading.data)} bytes in {slot.file}")
        return reading


def _beside(place: Place, body: bytes) -> tuple[bytes, Bytes]:
    """The header and the buffers of a payload that came with its envelope."""
    if len(body) != place.header + place.stored:
        raise WireError(Refused.MALFORMED, f"{len(body)} bytes came; cut short?")
    header = body[: place.header]
    if place.zstd:
        return header, _decompressed(body[place.header :], place.size)
    return header, np.frombuffer(body, np.uint8)[place.header :]


def _decompressed(data: bytes, size: int) -> Bytes:
    try:
        # The frame's own word decides how much is allocated, so it is held against ours first.
        if zstandard.frame_content_size(data) != size:
            raise WireError(Refused.MALFORMED, "a compressed payload of another size than it says")
        raw = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    except zstandard.ZstdError as error:
        raise WireError(Refused.MALFORMED, f"a compressed payload is damaged: {error}") from None
    return np.frombuffer(raw, np.uint8)
