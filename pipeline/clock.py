"""The graph's clocks: integer nanoseconds that only move forward."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Tells the time of a graph."""

    def now(self) -> int:
        """ns on the graph's clock."""
        ...


class ScaledClock:
    """Graph time that starts at `origin` and runs at `speed` times real time.

    With `speed` 1 and the wall clock as origin this is the clock of a flight; with a recording's
    first instant as origin it replays that recording.
    """

    def __init__(self, origin: int, speed: float = 1.0, *, began_ns: int | None = None) -> None:
        """`began_ns`: when it began, on this host's monotonic clock, where others share it."""
        if not speed > 0:
            raise ValueError(f"speed must be above 0, not {speed}")
        self._origin = origin
        self._speed = speed
        self._shared_ns = began_ns
        self.start()

    def start(self) -> None:
        """Begin (again) at the origin; a shared clock has begun when it did."""
        self._start = time.monotonic_ns() if self._shared_ns is None else self._shared_ns

    def now(self) -> int:
        elapsed = time.monotonic_ns() - self._start
        return self._origin + (elapsed if self._speed == 1.0 else int(elapsed * self._speed))

    def seconds_until(self, instant: int) -> float:
        return (instant - self.now()) / (1e9 * self._speed)


class ManualClock:
    """Time that stands still until it is told to move: offline, in tests, when planning."""

    def __init__(self, now: int = 0) -> None:
        self._now = now

    def now(self) -> int:
        return self._now

    def advance_to(self, instant: int) -> None:
        """Move to `instant`; raises ValueError if that lies in the past."""
        if instant < self._now:
            raise ValueError(f"time cannot run backward from {self._now} to {instant}")
        self._now = instant
