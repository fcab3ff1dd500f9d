"""The publishing end of a channel, whatever carries its bytes."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import zstandard

from pipeline.errors import WireError
from pipeline.transport.channel import Channel, ChannelStatistics, Send
from pipeline.transport.codec import Encoded, encode
from pipeline.transport.envelope import NO_BOUND, Envelope, Kind, Place, pack
from pipeline.transport.ring import RingWriter
from pipeline.transport.shared_files import FOLDER

#: Buffers up to this size go beside the envelope: below it a slot costs more than the copies.
INLINE_BYTES = 16 << 10
#: How long a channel may be silent before its last news are sent again, for whoever came late.
REPEAT_S = 0.2


class Outlet:
    """Numbers, encodes and sends the messages of one channel; one lock keeps their order, since
    the last news are repeated from another thread."""

    def __init__(
        self, channel: Channel, send: Send, *, run: str, epoch: int, folder: Path = FOLDER
    ) -> None:
        self.channel = channel
        self._send = send if channel.wire is None else channel.wire(send)
        self._epoch = epoch
        self._schema = channel.schema.hash
        self._ring = RingWriter(run, slots=channel.slots, budget=channel.ring_bytes, folder=folder)
        self._lock = threading.Lock()
        self._large = False  #: the last payload was, so a slot is ready for the next
        self._last = Envelope(Kind.HELLO, channel.port, NO_BOUND)
        self._sent_at = time.monotonic()
        self._published = self._bytes = self._sent_whole = 0

    def publish(self, envelope: Envelope, payload: Any) -> None:
        """Send a message or news. Raises WireError where the payload cannot travel."""
        with self._lock:
            self._sent_at = time.monotonic()
            if envelope.kind is Kind.MESSAGE:
                self._message(envelope, payload)
            else:
                self._send(self._stamped(envelope, Place()), b"")
            self._last = envelope

    def repeat(self, now: float | None = None) -> None:
        """Send the last news again: at once, or with `now` only after a silence.

        Never waits: while something is being published, that is the news.
        """
        if not self._lock.acquire(blocking=False):
            return
        try:
            if now is None or now - self._sent_at >= REPEAT_S:
                self._sent_at = time.monotonic()
                last = self._last
                if last.kind is Kind.MESSAGE:  # of a message only the bound after it is news
                    last = Envelope(Kind.BOUND, last.port, last.bound, seq=last.seq)
                self._send(self._stamped(last, Place()), b"")
        finally:
            self._lock.release()

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

    def _message(self, envelope: Envelope, payload: Any) -> None:
        # A stream whose last payload was large has a slot for the next: told of it at once, its
        # readers wake while the payload is made ready.
        announced = self._large and self._announce(envelope)
        try:
            encoded = self._encode(payload)
        except BaseException:
            if announced:
                self._ring.withdraw()
            raise
        needed = len(encoded.header) + encoded.size
        self._large = self.channel.local and encoded.size > INLINE_BYTES
        if announced and needed > self._ring.room():
            self._ring.withdraw()
            announced = False
        if announced or (self._large and self._announce(envelope, needed)):
            self._ring.fill(encoded.header, encoded.size, encoded.write_into)
        else:
            self._sent_whole += self._large
            self._whole(envelope, encoded)
        self._published += 1
        self._bytes += needed

    def _announce(self, envelope: Envelope, size: int = 0) -> bool:
        """Claim a slot and tell the readers of it; False where there is none."""
        slot = self._ring.claim(size)
        if slot is None:
            return False
        try:
            self._send(self._stamped(envelope, Place(slot=slot)), b"")
        except BaseException:
            self._ring.withdraw()
            raise
        return True

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
            envelope._replace(
                schema=self._schema, epoch=self._epoch, number=self._published, place=place
            )
        )
