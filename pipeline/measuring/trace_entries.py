"""What a trace is made of: the entries of a recorded run, in words.

`at`, `made` and `end` are `time.monotonic_ns`; stamps and `now` are on the graph's clock, in ns.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, TypeAlias

#: The numbers, on their output port, of the messages of one input: None without one, a tuple (of
#: tuples) where the input takes several.
Chosen: TypeAlias = "int | tuple[Chosen, ...] | None"


class Published(NamedTuple):
    """An output port took a message."""

    at: int
    stage: str
    port: str
    seq: int
    stamp: int  #: on the graph's clock, as every stamp
    now: int  #: on the graph's clock
    oldest: tuple[tuple[str, int], ...]  #: per sensor stream that went in, its oldest stamp


class Refused(NamedTuple):
    """An output port did not take a message."""

    at: int
    stage: str
    port: str
    stamp: int
    reason: str


class Dropped(NamedTuple):
    """A message ended unused on the edge from `origin`/`port` to input `name` of `stage`."""

    at: int
    origin: str
    port: str
    stage: str
    name: str
    seq: int
    stamp: int
    reason: str


class SetFormed(NamedTuple):
    """The sync decision: run `number` of a stage starts with these inputs."""

    at: int
    stage: str
    number: int
    trigger: int  #: its stamp
    chosen: tuple[Chosen, ...]  #: one per input of the stage
    marks: tuple[tuple[str, int, str], ...]  #: (input, edge number in it, mark)


class RunEnded(NamedTuple):
    """A run is over, in its order: "finished", "filtered", "failed" or "abandoned"."""

    at: int
    stage: str
    number: int
    how: str


class Told(NamedTuple):
    """An event: something that a person should know."""

    at: int
    kind: str
    subject: str
    text: str


class Stepped(NamedTuple):
    """A thread executed one step of a run."""

    at: int  #: its beginning
    end: int
    stage: str
    number: int
    step: str
    device: str | None
    thread: str


class Sampled(NamedTuple):
    """A source made a sample and, later, had brought it."""

    at: int  #: the driver asked for it
    made: int  #: it was there
    end: int  #: its publication and whatever that started on this thread are over
    stage: str
    thread: str


Entry: TypeAlias = Published | Refused | Dropped | SetFormed | RunEnded | Told | Stepped | Sampled

KINDS: Mapping[str, type[Entry]] = {
    kind.__name__: kind
    for kind in (Published, Refused, Dropped, SetFormed, RunEnded, Told, Stepped, Sampled)
}
