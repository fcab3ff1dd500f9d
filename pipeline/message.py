"""The message: a payload with the times it stands for and the samples it was made from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeAlias, TypeVar

T = TypeVar("T", covariant=True)

#: The furthest that `begin` and `end` may lie from `stamp`; a message beyond it is refused at the
#: port. It bounds what a `span` input must keep (one second covers a 1 Hz spinning LiDAR).
MAX_EXTENT_NS = 1_000_000_000


class Sample(NamedTuple):
    """One sensor sample in a lineage."""

    stream: str  #: the source's output port, ``stage/port``
    stamp: int  #: ns on the graph's clock
    received: int  #: ns on the graph's clock: when it arrived at this host


@dataclass(frozen=True, slots=True, eq=False)
class Message(Generic[T]):
    """A payload and its times, all integer nanoseconds on the graph's clock.

    Messages are compared by identity; their payload is shared by reference and read-only.
    """

    payload: T
    stamp: int  #: the reference instant (mid-sweep for a spinning LiDAR)
    begin: int  #: first instant of the capture, <= stamp
    end: int  #: last instant of the capture, >= stamp
    received: int  #: when the message arrived at its output port; at a source: at this host
    seq: int = 0  #: number on its output port, from 0
    lineage: tuple[Sample, ...] = ()  #: every sensor sample that went in
    executor: str | None = None  #: the device whose model made it; None: no model
    degraded: bool = False  #: it, or something in it, was made on a lower rung of a ladder

    @classmethod
    def at(
        cls,
        stamp: int,
        payload: T,  # type: ignore[misc]  # a constructor, so covariance is safe
        *,
        begin: int | None = None,
        end: int | None = None,
        received: int | None = None,
    ) -> Message[T]:
        """A message as a source or a stage makes it: `begin`, `end` and `received` default to
        sense.

        `received` defaults to `end`: a sample arrives once its capture is over. The framework fills
        in `seq` and `lineage` when it publishes the message.
        """
        begin = stamp if begin is None else begin
        end = stamp if end is None else end
        return cls(payload, stamp, begin, end, end if received is None else received)


#: What an input with ``sync: span`` receives: the messages around every instant, by stamp.
Span: TypeAlias = tuple[Message[T], ...]
