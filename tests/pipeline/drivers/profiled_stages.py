"""Stages that take a known amount of work, for the tests of the profiler."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any

from pipeline.message import Message
from pipeline.stage import Source, Stage

MS = 1_000_000


def burn(loops: int) -> int:
    """A fixed loop over integers."""
    total = 0
    for number in range(loops):
        total += number & 7
    return total


def burn_ns(loops: int) -> int:
    """The same; what the calling thread's own clock says that it took."""
    before = time.thread_time_ns()
    burn(loops)
    return time.thread_time_ns() - before


class Beat(Source):
    """`count` messages, `period_ms` apart."""

    def __init__(self, *, count: int = 20, period_ms: float = 20.0) -> None:
        self.count = count
        self.period_ms = period_ms

    def messages(self) -> Iterator[Message[int]]:
        for number in range(self.count):
            yield Message.at(round(number * self.period_ms * MS), number)


class Burn(Stage):
    """Runs the fixed loop for every message, and adds up what it took."""

    def __init__(self, *, loops: int) -> None:
        self.loops = loops
        self.burnt_ns = 0

    def process(self, x: Message[Any]) -> int:
        self.burnt_ns += burn_ns(self.loops)
        return self.burnt_ns

    def statistics(self) -> Mapping[str, float]:
        return {"burnt_ms": self.burnt_ns / 1e6}
