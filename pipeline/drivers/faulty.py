"""A source as its faults make it: it dies and returns, repeats a message, jumps in time, stalls.

Pure: messages in, messages out, by their own times alone. So a fault is the same in a live run, in
one offline, and in a test.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

from pipeline.graph.faults import SourceFaults
from pipeline.message import Message


class Unheard(NamedTuple):
    """What a driver takes its time for, and publishes nothing: a message of a dead sensor, or the
    word that a fault begins or ends."""

    received: int  #: ns on the graph's clock
    stamp: int  #: its place among the messages, offline
    text: str | None = None  #: to be told as an event


#: What a source hands to a driver.
Sampled: TypeAlias = Message[Any] | Unheard


def with_faults(
    sources: Mapping[str, Iterator[Message[Any]]], faults: Mapping[str, SourceFaults], origin: int
) -> dict[str, Iterator[Sampled]]:
    """The sources, those with faults as these make them; the graph's clock began at `origin`."""
    return {
        name: messages if name not in faults else faulty(messages, faults[name], origin)
        for name, messages in sources.items()
    }


def faulty(
    messages: Iterator[Message[Any]], faults: SourceFaults, origin: int
) -> Iterator[Sampled]:
    """What a driver gets of a source in place of `messages`."""
    turns = _turns(faults)
    last: Message[Any] | None = None
    for message in messages:
        at = message.received - origin
        while turns and turns[0][0] <= at:
            turn, text = turns.pop(0)
            yield Unheard(origin + turn, message.stamp, text)
            if text == _REPEATS and last is not None:
                yield replace(last, received=origin + turn)
        if _within(at, faults.dies_at, faults.returns_at):
            yield Unheard(message.received, message.stamp)
            continue
        last = _shifted(message, faults, origin)
        yield last


_REPEATS = "repeats its last message, as its faults say"


def _turns(faults: SourceFaults) -> list[tuple[int, str]]:
    """When something begins or ends, ns from the origin, and the sentence."""
    stalls, lasts = faults.stalls_at, faults.stalls_for
    known = (
        (faults.dies_at, "dies, as its faults say"),
        (faults.returns_at, "is back from the dead"),
        (faults.repeats_at, _REPEATS),
        (faults.jumps_at, f"its clock jumps by {faults.jumps_by / 1e6:+g} ms, as its faults say"),
        (stalls, f"stalls for {lasts / 1e9:g} s, as its faults say"),
        (None if stalls is None else stalls + lasts, "is through with its stall"),
    )
    return sorted((at, text) for at, text in known if at is not None)


def _within(at: int, begin: int | None, end: int | None) -> bool:
    return begin is not None and begin <= at and (end is None or at < end)


def _shifted(message: Message[Any], faults: SourceFaults, origin: int) -> Message[Any]:
    """The message with the times that its faults give it."""
    at, by = message.received - origin, faults.jumps_by
    if faults.stalls_at is not None and faults.stalls_at <= at:
        over = origin + faults.stalls_at + faults.stalls_for
        message = replace(message, received=max(message.received, over))
    if faults.jumps_at is not None and faults.jumps_at <= at:
        stamp, begin, end = message.stamp + by, message.begin + by, message.end + by
        message = replace(message, stamp=stamp, begin=begin, end=end)
    return message
