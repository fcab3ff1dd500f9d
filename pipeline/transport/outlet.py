"""The publishing end of a channel, whatever carries its bytes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import zstandard

from pipeline.errors import WireError
from pipeline.transport.channel import Channel, ChannelStatistics
from pipeline.transport.codec import Encoded, encode
from pipeline.transport.envelope import NO_BOUND, Envelope, Kind, Place, Slot, pack
from pipeline.transport.ring import RingWriter
from pipeline.transport.shared_files import FOLDER

#: Buffers up to this size go beside the envelope: below it a slot costs more than the copies.
INLINE_BYTES = 16 << 10
#: How long a channel may be silent before its last news are sent again, for whoever came late.
REPEAT_S = 0.2

#: Takes an envelope and what goes with it; must not wait unless the channel says `block`.
Send = Callable[[bytes, bytes], None]


class Outlet:
    """Numbers, encodes and sends the messages of one channel; one lock keeps their order, since
    the last news are repeated from another thread."""

    def __init__(
        self, channel: Channel, send: Send, *, run: str, epoch: int, folder: Path = FOLDER
    ) -> None:
        self.channel = channel
        self._send = send
        self._epoch = epoch
        self._ring = RingWriter(run, slots=channel.slots, budget=channel.ring_bytes, folder=folder)
        self._lock = threading.Lock()
        self._news = Envelope(Kind.HELLO, channel.port, NO_BOUND)
        self._sent_at = time.monotonic()
        self._published = self._bytes = self._sent_whole = 0

    def publish(self, envelope: Envelope, payload: Any) -> None:
        """Send a message or news. Raises WireError where the payload cannot travel."""
        encoded = self._encode(payload) if envelope.kind is Kind.MESSAGE else None
        with self._lock:
            self._sent_at = time.monotonic()
            if encoded is None:
                self._news = envelope
                self._send(self._stamped(envelope, Place()), b"")
                return
            self._news = Envelope(Kind.BOUND, envelope.port, envelope.bound)
            if not (self.channel.local and self._by_ring(envelope, encoded)):
                self._whole(envelope, encoded)
            self._published += 1
            self._bytes += encoded.size + len(encoded.header)

    def repeat(self, now: float | None = None) -> None:
        """Send the last news again: at once, or with `now` only after a silence."""
        with self._lock:
            if now is None or now - self._sent_at >= REPEAT_S:
                self._sent_at = time.monotonic()
                self._send(self._stamped(self._news, Place()), b"")

    def statistics(self) -> ChannelStatistics:
        return ChannelStatistics(
            published=self._published, bytes=self._bytes, sent_whole=self._sent_whole
        )

    def close(self) -> None:
        """Remove the shared memory."""
        with self._lock:
            self._ring.close()

    def _encode(self, payload: Any) -> Encoded:
        channel = self.channel
        if channel.compressor is not None:
            payload = channel.compressor.shrink(payload)
        try:
            return encode(payload, channel.schema, channel.max_bytes)
        except WireError as error:
            raise WireError(error.reason, f"{channel.port}: {error}") from None

    def _by_ring(self, envelope: Envelope, encoded: Encoded) -> bool:
        if encoded.size <= INLINE_BYTES:
            return False
        size = encoded.size

        def announce(slot: Slot) -> None:
            place = Place(len(encoded.header), size, size, slot)
            self._send(self._stamped(envelope, place), encoded.header)

        if self._ring.write(size, encoded.write_into, announce):
            return True
        self._sent_whole += 1
        return False

    def _whole(self, envelope: Envelope, encoded: Encoded) -> None:
        header, size, level = len(encoded.header), encoded.size, self.channel.zstd
        body = encoded.tobytes()
        if level is None or size <= INLINE_BYTES:
            self._send(self._stamped(envelope, Place(header, size, size)), body)
            return
        packed = zstandard.compress(memoryview(body)[header:], level)
        place = Place(header, size, len(packed), zstd=True)
        self._send(self._stamped(envelope, place), encoded.header + packed)

    def _stamped(self, envelope: Envelope, place: Place) -> bytes:
        return pack(
            replace(
                envelope,
                schema=self.channel.schema.hash,
                epoch=self._epoch,
                number=self._published,
                place=place,
            )
        )
