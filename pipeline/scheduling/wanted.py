"""Wanted frames: which frames of a stream somebody downstream will choose.

Section 10 of README.md in this folder. Everything here is arithmetic on stamps: a trigger's next
stamps are predicted from its period and phase, and a frame is wanted when it is the one that an
input would choose for one of them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import pairwise
from statistics import median_high

from pipeline.scheduling.topology import Sync

#: Gaps between stamps that a prediction looks back on, and the least number of them.
GAPS = 8
LEAST_GAPS = 4
#: A prediction holds for so many periods past the last stamp.
HOLDS = 3
#: Frames to look ahead for the next one that must be run.
AHEAD = 16


class Verdict(IntEnum):
    """What a frame is to a stage with ``run: wanted``."""

    NO = 0  #: nobody will choose it
    MAY = 1  #: somebody takes any frame
    MUST = 2  #: a settled input will choose it
    EVERY = 3  #: nothing can be predicted: run it as ``run: every`` would


class Rhythm:
    """The last stamps of a stream, its period, and whether it is regular enough to predict."""

    __slots__ = ("_period_before", "arrived", "period", "regular", "stamps")

    def __init__(self) -> None:
        self.stamps: deque[int] = deque(maxlen=GAPS + 1)
        self.arrived = 0  #: when the last one came
        self.period = 0
        self._period_before = 0  #: before the last stamp was counted
        self.regular = False

    def add(self, stamp: int, now: int) -> None:
        self.stamps.append(stamp)
        self.arrived = now
        self._period_before = self.period
        gaps = [after - before for before, after in pairwise(self.stamps)]
        if gaps:
            self.period = median_high(gaps)
            even = sum(4 * abs(gap - self.period) <= self.period for gap in gaps)
            self.regular = len(gaps) >= LEAST_GAPS and 2 * even > len(gaps)

    @property
    def gap(self) -> int:
        """Twice the way back to the last instant that the frame before was said to be for."""
        return 2 * (self.stamps[-1] - self.stamps[-2]) - self._period_before

    @property
    def wobble(self) -> int:
        """The greatest difference of a gap from the period."""
        return max(abs(after - before - self.period) for before, after in pairwise(self.stamps))

    def holds(self, stamp: int) -> bool:
        """Whether what is predicted still says something at this stamp."""
        return self.regular and stamp <= self.stamps[-1] + HOLDS * self.period

    def instants(self, around: int) -> Iterable[int]:
        """The stamps that came or are predicted, those of the latter on each side of `around`."""
        last, period = self.stamps[-1], self.period
        yield from list(self.stamps)[-GAPS:]
        below = (around - last) // period
        for count in (below, below + 1):
            yield last + max(count, 1) * period


@dataclass(frozen=True, slots=True)
class Need:
    """A nearest slot without which a set is skipped, and the source of its messages."""

    root: Rhythm
    tolerance: int
    offset: int

    def unmet(self, instant: int) -> bool:
        """Whether no message is foreseen in reach of a trigger at this stamp."""
        root, at = self.root, instant - self.offset
        if not root.holds(at) or at < root.stamps[-min(GAPS, len(root.stamps))]:
            return False
        # Once for the last stamp, which may have come late, and once for the next.
        reach = self.tolerance + 2 * root.wobble
        return all(abs(stamp - at) > reach for stamp in root.instants(at))


@dataclass(frozen=True, slots=True)
class MustWish:
    """A settled input downstream chooses for each stamp of another stream, the wish's root."""

    root: Rhythm
    sync: Sync
    tolerance: int
    offset: int
    needs: tuple[Need, ...] = ()  #: of the stage that the input is one of

    def void(self, instant: int) -> bool:
        """Whether the set of an instant will be skipped, so that nobody uses what it chooses."""
        return any(need.unmet(instant) for need in self.needs)

    def meets(self, stamp: int, gap: int, period: int) -> bool:
        """Whether the input would choose a frame at `stamp`, `gap` after the one before it."""
        frame = stamp + self.offset
        for instant in self.root.instants(frame):
            ahead = instant - frame
            if self.sync is Sync.NEAREST:
                chosen = abs(ahead) <= self.tolerance and -gap < 2 * ahead <= period
            elif self.sync is Sync.LATEST:
                chosen = 0 <= ahead < period
            else:
                chosen = ahead == 0
            if chosen and not self.void(instant):
                return True
        return False


@dataclass(slots=True)
class Wishes:
    """What all inputs downstream of a stage (of all members of its select group) wish of it."""

    musts: list[MustWish] = field(default_factory=list)
    all: bool = False  #: a span input takes every frame
    may: bool = False  #: a trigger takes any frame

    def verdict(self, frames: Rhythm) -> Verdict:
        """Judge the last frame of a stage's rhythm."""
        stamp = frames.stamps[-1]
        if not frames.regular or not all(wish.root.holds(stamp) for wish in self.musts):
            return Verdict.EVERY
        if self.all or any(w.meets(stamp, frames.gap, frames.period) for w in self.musts):
            return Verdict.MUST
        return Verdict.MAY if self.may else Verdict.NO

    def next_must(self, frames: Rhythm, stamp: int) -> int | None:
        """When the next frame that must be run is due, seen from a frame at `stamp`."""
        if not frames.regular or stamp > frames.stamps[-1] + HOLDS * frames.period:
            return None
        musts: Sequence[MustWish] = [w for w in self.musts if w.root.holds(stamp)]
        last, period = frames.stamps[-1], frames.period
        for ahead in range(period, (AHEAD + 1) * period, period):
            if self.all or any(wish.meets(last + ahead, period, period) for wish in musts):
                return frames.arrived + ahead
        return None
