"""Stages that take a known amount of work, for the tests of the profiler."""

from __future__ import annotations

from collections.abc import Iterator
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


class Beat(Source):
    """`count` messages, `period_ms` apart."""

    def __init__(self, *, count: int = 20, period_ms: float = 20.0) -> None:
        self.count = count
        self.period_ms = period_ms

    def messages(self) -> Iterator[Message[int]]:
        for number in range(self.count):
            yield Message.at(round(number * self.period_ms * MS), number)


class Burn(Stage):
    """Runs the fixed loop for every message."""

    def __init__(self, *, loops: int) -> None:
        self.loops = loops

    def process(self, x: Message[Any]) -> int:
        return burn(self.loops)
