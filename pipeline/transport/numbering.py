"""Which messages of a channel are new, which were seen before, and how many never came.

A publisher numbers its messages from 0 in each life (epoch). News without a payload carry the
number of the next message, so that also the loss of the last one is noticed. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.errors import WireError

#: A publisher repeats its news five times a second. After this long without any it counts as dead,
#: and one whose clock stands earlier (a computer that was started anew without one) is believed.
SILENCE_NS = 1_000_000_000


@dataclass(slots=True)
class Numbering:
    """What one subscriber has seen of one channel."""

    missed_before: int = 0  #: published before we first heard of the publisher
    lost: int = 0
    _epoch: int | None = None
    _next: int = 0  #: the number of the next message
    _heard: int = 0  #: ns, when something of this epoch came last

    def message(self, epoch: int, number: int, now: int) -> int:
        """Take a message; how many before it are lost. Raises WireError where it is not new."""
        lost = self.news(epoch, number, now)
        self._next = number + 1
        return lost

    def news(self, epoch: int, number: int, now: int) -> int:
        """Take news of the stream, which may come again; how many messages before are lost."""
        if self._epoch is None or epoch != self._epoch:
            return self._new_life(epoch, number, now)
        if number < self._next:
            raise WireError("replayed", f"number {number} again; {self._next} is next")
        self._heard = now
        lost, self._next = number - self._next, number
        self.lost += lost
        return lost

    def _new_life(self, epoch: int, number: int, now: int) -> int:
        first = self._epoch is None
        if self._epoch is not None and epoch < self._epoch and now - self._heard < SILENCE_NS:
            raise WireError("stale", f"of epoch {epoch}; its publisher lives in {self._epoch} now")
        self._epoch, self._next, self._heard = epoch, number, now
        if first:  # what was sent before we listened was not ours to lose
            self.missed_before = number
            return 0
        self.lost += number
        return number
