"""A wire that is cut, slow, or loses messages: between a channel's end and the network.

It lies under the numbers that an outlet gives, so what it swallows is missed, and counted, by the
reader as on a real network.
"""

from __future__ import annotations

import random
import threading
import time
import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import inf

from pipeline.transport.channel import Send
from pipeline.transport.envelope import Kind, unpack


@dataclass(frozen=True, slots=True)
class WireFaults:
    """What is wrong with a wire, in seconds of the graph's time since its beginning."""

    cut_at_s: float = inf
    restored_at_s: float = inf
    delay_s: float = 0.0
    drops: float = 0.0  #: the share of messages that are lost; news of a stream are not
    seed: int = 0


class BadWire:
    """One end's wire; in order until it is begun, and `close` lets go what it holds."""

    def __init__(
        self, faults: WireFaults, name: str, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        """`name` makes wires of one seed lose different messages."""
        self._faults = faults
        self._now_s = now_s
        self._elapsed_s: Callable[[], float] | None = None
        self._random = random.Random(zlib.crc32(name.encode(), faults.seed & 0xFFFFFFFF))
        self._late: deque[tuple[float, Send, bytes, bytes]] = deque()
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._closed = False

    def lay(self, send: Send) -> Send:
        """`send` through this wire."""

        def through(head: bytes, body: bytes) -> None:
            if self._swallows(head):
                return
            if self._thread is None or self._closed:
                send(head, body)
                return
            with self._changed:
                self._late.append((self._now_s() + self._faults.delay_s, send, head, body))
                self._changed.notify()

        return through

    def begin(self, elapsed_s: Callable[[], float]) -> None:
        """From now on it is as bad as its faults say at the time that `elapsed_s` tells."""
        self._elapsed_s = elapsed_s
        if self._faults.delay_s:
            self._thread = threading.Thread(target=self._deliver, name="slow-link", daemon=True)
            self._thread.start()

    def close(self) -> None:
        """Deliver at once what is on its way, and end the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()

    def _swallows(self, head: bytes) -> bool:
        if self._elapsed_s is None:
            return False
        faults = self._faults
        if faults.cut_at_s <= self._elapsed_s() < faults.restored_at_s:
            return True
        is_message = faults.drops > 0 and unpack(head).kind is Kind.MESSAGE
        return is_message and self._random.random() < faults.drops

    def _deliver(self) -> None:
        while True:
            with self._changed:
                while not self._late and not self._closed:
                    self._changed.wait()
                if not self._late:
                    return
                due, send, head, body = self._late[0]
                wait = 0.0 if self._closed else due - self._now_s()
                if wait > 0:
                    self._changed.wait(wait)
                    continue
                self._late.popleft()
            send(head, body)
