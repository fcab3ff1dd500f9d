"""The graph's clock on several hosts: one tells it, the others follow.

The hosts' own clocks need not agree. A beacon says what the graph's clock showed when it was sent;
it was later when it arrives, by the way it took. Of many beacons the one with the shortest way
counts, so a follower is behind by no more than the least way of all: some tenths of a millisecond
in a local network, as much as the link's own delay over a slow one.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from pipeline.clock import Clock
from pipeline.transport.channel import Arrival, Channel, Transport
from pipeline.transport.envelope import Envelope, Kind
from pipeline.transport.schema import PayloadSchema

#: Beacons that a follower hears before it begins: a second of them.
ENOUGH = 5


def channel(run: str, process: str) -> Channel:
    """Where a process tells the clock."""
    return Channel(f"{run}/clock/{process}", "clock", PayloadSchema.of([]), local=False)


class ClockBeacon:
    """Tells the graph's clock, a few times a second."""

    def __init__(self, run: str, process: str, transport: Transport) -> None:
        self._channel = channel(run, process)
        self._transport = transport
        transport.advertise(self._channel)

    def tell(self, clock: Clock) -> None:
        news = Envelope(Kind.BOUND, self._channel.port, clock.now())
        self._transport.publish(self._channel.key, news)


class ClockFollower:
    """What the beacons say of the graph's clock; `speed` is graph time over real time."""

    def __init__(self, speed: float = 1.0, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._speed = speed
        self._now_ns = now_ns
        self._lock = threading.Lock()
        self._count = 0
        self._best: tuple[int, int] | None = None  #: the graph's time, and ours

    def listen(self, run: str, process: str, transport: Transport) -> None:
        """Hear the beacons of a process."""
        transport.subscribe(channel(run, process), self.heard)

    def heard(self, arrival: Arrival) -> None:
        """A beacon; one that is repeated after a silence is older, and counts for nothing."""
        if arrival.envelope.kind is not Kind.BOUND:
            return
        ours, graph = self._now_ns(), arrival.envelope.bound
        with self._lock:
            self._count += 1
            if self._best is None or graph > self._at(self._best, ours):
                self._best = graph, ours

    def known(self) -> tuple[int, int] | None:
        """The graph's time at an instant of this host's monotonic clock, ns; None: too early."""
        with self._lock:
            return self._best if self._count >= ENOUGH else None

    def _at(self, known: tuple[int, int], ours: int) -> int:
        graph, then = known
        return graph + int((ours - then) * self._speed)
