"""The ledger: every message on every edge ends once, every run of every stage ends once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from pipeline.scheduling.events import Mark, Reason


@dataclass(slots=True, eq=False)
class EdgeBook:
    """One edge: produced = delivered + dropped + in flight, after every step of the machine."""

    produced: int = 0
    delivered: int = 0  #: messages, at their first use in a started run
    reused: int = 0  #: later uses; outside the balance
    dropped: dict[Reason, int] = field(default_factory=dict)

    def drop(self, reason: Reason) -> None:
        self.dropped[reason] = self.dropped.get(reason, 0) + 1

    def page(self, in_flight: int) -> dict[str, Any]:
        """The book as plain values; `in_flight` is counted by the caller from what is held."""
        return {
            "produced": self.produced,
            "delivered": self.delivered,
            "reused": self.reused,
            "dropped": {str(reason): count for reason, count in sorted(self.dropped.items())},
            "in_flight": in_flight,
        }


@dataclass(slots=True, eq=False)
class RunBook:
    """One stage: started = finished + filtered + failed + abandoned + running."""

    started: int = 0
    finished: int = 0
    filtered: int = 0  #: the stage said None on every port
    failed: int = 0
    abandoned: int = 0  #: between steps: too old, device lost, stop
    unsettled: int = 0  #: inputs used before they were settled
    missing: int = 0
    held: int = 0

    def end(self, how: str) -> None:
        """One run ended: "finished", "filtered", "failed" or "abandoned"."""
        if how == "finished":
            self.finished += 1
        else:
            setattr(self, how, getattr(self, how) + 1)

    def mark(self, marks: Iterable[tuple[str, int, Mark]]) -> None:
        """A run starts with inputs that are not the settled ones."""
        for _, _, mark in marks:
            self.unsettled += mark is Mark.UNSETTLED
            self.missing += mark is Mark.MISSING
            self.held += mark is Mark.HELD

    def page(self, running: int) -> dict[str, int]:
        """The book as plain values."""
        return {
            "started": self.started,
            "finished": self.finished,
            "filtered": self.filtered,
            "failed": self.failed,
            "abandoned": self.abandoned,
            "running": running,
        }


def balanced(pages: dict[str, dict[str, Any]]) -> bool:
    """Whether every edge's book balances."""
    return all(
        page["produced"] == page["delivered"] + sum(page["dropped"].values()) + page["in_flight"]
        for page in pages.values()
    )
