"""What a run that is one part of a graph asks of the others, and when."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from pipeline.drivers.exchange import Exchange


@dataclass(frozen=True, slots=True)
class Go:
    """When and on which clock a part begins."""

    origin: int  #: the graph's time at `began_ns`
    began_ns: int  #: on this host's monotonic clock
    late: bool  #: the others are under way: samples that have arrived before now are left out


class Stoppable(Protocol):
    """A driver that can be asked to end."""

    def stop(self) -> None: ...


@dataclass(frozen=True, slots=True)
class Joint:
    """One part's ties: `open`, connect the `exchange`, `ready`, then the run with it."""

    exchange: Exchange
    open: Callable[[], None]  #: opens the exchange's transport
    ready: Callable[[int | None], Go]  #: says when the first sample arrives; waits for the word
    running: Callable[[Stoppable], None]  #: the driver is there
    books: Callable[[], Mapping[str, object]]  #: what the transport counted, for the report
