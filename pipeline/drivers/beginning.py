"""Where the sources of a run begin: their first arrivals, and what a late process leaves out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import dropwhile
from typing import Any

from pipeline.clock import ScaledClock
from pipeline.drivers.faulty import Sampled
from pipeline.message import Message


def first_arrivals(
    sources: Mapping[str, Iterator[Message[Any]]],
) -> tuple[dict[str, Iterator[Message[Any]]], int | None]:
    """The sources again, and when their first message arrives, if any does: the origin of the
    graph's clock."""
    ready: dict[str, Iterator[Message[Any]]] = {}
    arrivals: list[int] = []
    for name, messages in sources.items():
        first = next(messages, None)
        if first is not None:
            arrivals.append(first.received)
        ready[name] = _chain(first, messages)
    return ready, min(arrivals, default=None)


def from_now_on(
    sources: Mapping[str, Iterator[Sampled]], clock: ScaledClock
) -> dict[str, Iterator[Sampled]]:
    """The sources without what arrived while their process was not there."""
    now = clock.now()
    return {
        name: dropwhile(lambda message: message.received < now, messages)
        for name, messages in sources.items()
    }


def _chain(first: Message[Any] | None, messages: Iterator[Message[Any]]) -> Iterator[Message[Any]]:
    if first is not None:
        yield first
    yield from messages
