"""Output ports: which stamps they take, and the lowest stamp that may still come on them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pipeline.message import MAX_EXTENT_NS, Message
from pipeline.scheduling.events import Refusal
from pipeline.scheduling.topology import Port
from pipeline.scheduling.wanted import Rhythm

if TYPE_CHECKING:
    from pipeline.scheduling.edges import Edge

#: Above and below every stamp; sums of them with offsets and tolerances stay exact.
INFINITY = 1 << 62
NEVER = -INFINITY


class OutputPort:
    """One output port: its last stamp, its bound, its edges and its book of refusals."""

    __slots__ = (
        "bound",
        "edges",
        "last",
        "min_period",
        "name",
        "port",
        "published",
        "refused",
        "rhythm",
    )

    def __init__(self, port: Port, min_period: int | None) -> None:
        self.port = port
        self.name = str(port)
        self.last = NEVER
        self.bound = NEVER
        self.min_period = min_period  #: the source's promise; None: none, or withdrawn
        self.published = 0
        self.refused: dict[Refusal, int] = {}
        self.edges: list[Edge] = []
        self.rhythm: Rhythm | None = None  #: kept where somebody's wishes are predicted from it

    @property
    def ended(self) -> bool:
        """No message can come any more."""
        return self.bound >= INFINITY

    def refusal(self, message: Message[Any]) -> Refusal | None:
        """Why the port does not take this message, or None; withdraws a broken promise."""
        stamp = message.stamp
        if self.ended:
            reason = Refusal.ENDED
        elif not (
            stamp - MAX_EXTENT_NS <= message.begin <= stamp <= message.end <= stamp + MAX_EXTENT_NS
        ):
            reason = Refusal.EXTENT
        elif stamp <= self.last:
            reason = Refusal.BACKWARD
        elif stamp < self.bound:
            reason = Refusal.EARLY
        else:
            return None
        self.refused[reason] = self.refused.get(reason, 0) + 1
        return reason

    def promised_after(self, stamp: int) -> int:
        """The bound that a source's message at `stamp` brings."""
        return stamp + (self.min_period or 1)
