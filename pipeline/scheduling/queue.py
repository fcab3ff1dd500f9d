"""Trigger queues: what waits to start a run, and what a full queue does."""

from __future__ import annotations

from collections import deque

from pipeline.scheduling.events import Reason
from pipeline.scheduling.sync import WaitingSet
from pipeline.scheduling.topology import Input, Policy


class TriggerQueue:
    """The triggers of one edge that no run and no waiting set has taken yet."""

    __slots__ = ("_policy", "_size", "entries", "peak")

    def __init__(self, rule: Input, *, lossless: bool) -> None:
        self._policy = Policy.BLOCK if lossless else rule.policy
        self._size = rule.size
        self.entries: deque[WaitingSet] = deque()
        self.peak = 0

    def __len__(self) -> int:
        return len(self.entries)

    def put(self, entry: WaitingSet) -> tuple[WaitingSet, Reason] | None:
        """Add a trigger; returns the one that the policy gives up for it, with the reason."""
        entries, policy = self.entries, self._policy
        lost: tuple[WaitingSet, Reason] | None = None
        if policy is Policy.LATEST:
            if entries:
                lost = (entries.popleft(), Reason.REPLACED)
        elif policy is not Policy.BLOCK and len(entries) >= self._size:
            if policy is Policy.DROP_NEWEST:
                return entry, Reason.QUEUE_FULL
            lost = (entries.popleft(), Reason.QUEUE_FULL)
        entries.append(entry)
        if len(entries) > self.peak:
            self.peak = len(entries)
        return lost

    def blocks(self, coming: int) -> bool:
        """Whether the producer must wait; `coming` are its runs in flight."""
        return self._policy is Policy.BLOCK and len(self.entries) + coming >= self._size
