"""The worker of a sender: takes the messages of a port to other processes, in their order.

A sender is an inline stage, so its steps run on whatever thread brought the message: two threads
may hold two of its runs at once. They are sent in the order in which they were started.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from pipeline.drivers.executor import PENDING, Pending
from pipeline.errors import WireError
from pipeline.message import Message
from pipeline.scheduling.events import Output, Run, Step
from pipeline.scheduling.partition import Link

#: A reader that has told nothing for so long is gone: nobody waits for it until it is back.
GONE_S = 1.0

#: Puts a message on its way. Raises WireError where it cannot travel.
Send = Callable[[Message[Any]], None]


class Sender:
    """One link's sending end. Called from any thread."""

    def __init__(self, link: Link, send: Send, now_s: Callable[[], float] = time.monotonic) -> None:
        self.link = link
        self._now_s = now_s
        self.failed = 0  #: messages that cannot travel
        self._send = send
        self._lock = threading.Lock()
        self._parked: dict[int, Run] = {}  #: started before an earlier run was sent, by number
        self._next = 0
        self._pending: deque[Run] = deque()  #: sent, not yet taken
        self._taken: dict[str, tuple[int, float]] = {}  #: by reader: up to which seq; heard when

    def execute(self, run: Run, step: Step) -> Sequence[Output] | Pending:
        """Send a run's message; with a window the run goes on until it is taken."""
        if self.link.window is None:
            self._send(run.inputs.trigger)
            return ()
        with self._lock:
            self._parked[run.number] = run
            while (ready := self._parked.pop(self._next, None)) is not None:
                self._next += 1
                try:
                    self._send(ready.inputs.trigger)
                except WireError:
                    self.failed += 1
                self._pending.append(ready)
        return PENDING

    def heard(self, reader: str, seq: int) -> None:
        """A reader took all up to `seq`, or is there and has taken nothing yet (-1)."""
        with self._lock:
            self._taken[reader] = (seq, self._now_s())

    def over(self) -> Sequence[Run]:
        """The runs that are over by now: all readers that are there took them."""
        now = self._now_s()
        with self._lock:
            there = [
                seq
                for reader in self.link.waiting
                for seq, heard in [self._taken.get(reader, (-1, 0.0))]
                if now - heard <= GONE_S
            ]
            ended: list[Run] = []
            while self._pending and (
                not there or self._pending[0].inputs.trigger.seq <= min(there)
            ):
                ended.append(self._pending.popleft())
        return ended
