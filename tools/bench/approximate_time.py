"""A baseline for the synchronizer: the newest set of messages that lies within a slop.

This is our own small reading of the idea behind ROS's ApproximateTimeSynchronizer, written for the
comparison, not its code: every topic keeps its last few stamps; whenever a message arrives, the
first combination with one message of every other topic that lies within the slop is a set, tried
from the nearest to that message outward; what a set used is forgotten.
"""

from __future__ import annotations

from itertools import product


class ApproximateTime:
    """Sets of `topics` stamps no further apart than `slop`; each topic keeps its last `size`."""

    def __init__(self, topics: int, slop: int, size: int = 10) -> None:
        self._held: list[list[int]] = [[] for _ in range(topics)]
        self._slop = slop
        self._size = size

    def add(self, topic: int, stamp: int) -> tuple[int, ...] | None:
        """A message arrives; the set it completes, in the order of the topics, or None."""
        held = self._held
        held[topic].append(stamp)
        del held[topic][: -self._size]
        near = [
            [stamp]
            if other == topic
            else sorted(
                (s for s in stamps if abs(s - stamp) <= self._slop), key=lambda s: abs(s - stamp)
            )
            for other, stamps in enumerate(held)
        ]
        for chosen in product(*near):
            if max(chosen) - min(chosen) <= self._slop:
                for stamps, used in zip(held, chosen, strict=True):
                    stamps.remove(used)
                return chosen
        return None
