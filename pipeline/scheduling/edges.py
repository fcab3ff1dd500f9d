"""One edge: from an output port to an input of a stage, with its book and its decimation."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pipeline.scheduling.bounds import OutputPort
from pipeline.scheduling.ledger import EdgeBook
from pipeline.scheduling.topology import Input

if TYPE_CHECKING:
    from pipeline.scheduling.stages import StageState
    from pipeline.scheduling.sync import Slot


class Edge:
    """The state of one edge; a trigger's has no slot."""

    __slots__ = ("_kept", "_previous", "book", "input", "origin", "period", "slot", "target")

    def __init__(self, origin: OutputPort, target: StageState, rule: Input) -> None:
        self.origin = origin
        self.target = target
        self.input = rule
        self.period = rule.period  #: of ``rate_hz``; None: takes every message
        self.book = EdgeBook()
        self.slot: Slot | None = None
        self._kept: int | None = None
        self._previous: int | None = None

    @property
    def name(self) -> str:
        """``stage/port->stage/port``, the key of the ledger."""
        return f"{self.origin.port}->{self.target.node.name}/{self.input.name}"

    def decimates(self, stamp: int) -> bool:
        """Whether ``rate_hz`` passes this message over.

        Half the stream's own period of slack keeps the rate exact under jitter: of 30 Hz at 10 Hz
        every third message is kept, although some come a little early.
        """
        period = self.period
        if period is None:
            return False
        gap = 0 if self._previous is None else stamp - self._previous
        self._previous = stamp
        if self._kept is not None and stamp < self._kept + period - gap // 2:
            return True
        self._kept = stamp
        return False
