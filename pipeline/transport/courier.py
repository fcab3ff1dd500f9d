"""Carries a channel to another host on a thread of its own: a slow link holds up nobody here.

One message waits while another is on its way, and a newer one takes its place: what the other host
gets is the latest that the link has time for. The numbers of those that did not go are missed, and
counted, by the reader.
"""

from __future__ import annotations

import threading

from pipeline.errors import TransportError
from pipeline.transport.channel import Send

#: How long the end of a stream may take to get out before the link is closed without it.
LINGER_S = 1.0


class Courier:
    """The way of one channel's messages and news; `send`, on its thread, may wait."""

    def __init__(self, name: str, send: Send) -> None:
        self._send = send
        self._changed = threading.Condition()
        self._message: tuple[bytes, bytes] | None = None
        self._news: tuple[bytes, bytes] | None = None  #: of what followed that message
        self._closed = False
        self._thread = threading.Thread(target=self._carry, name=name, daemon=True)
        self._thread.start()

    def send(self, head: bytes, body: bytes) -> None:
        """Take a message, or news, which have no body; never waits."""
        with self._changed:
            if body:
                self._message, self._news = (head, body), None
            else:
                self._news = head, body
            self._changed.notify()

    def close(self) -> None:
        """Let go what waits, if the link takes it soon."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(LINGER_S)

    def _carry(self) -> None:
        while True:
            with self._changed:
                while not (self._message or self._news or self._closed):
                    self._changed.wait()
                # First the message: news of what follows it would make it an old one.
                if self._message:
                    due, self._message = self._message, None
                elif self._news:
                    due, self._news = self._news, None
                else:
                    return
            try:
                self._send(*due)
            except TransportError:
                return  # the session is closed
