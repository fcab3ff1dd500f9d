"""Tolerance, offset and wait for a nearest input, as the measured streams would have them."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from math import ceil

import numpy as np
from numpy.typing import NDArray

from pipeline.recording.explanation import Candidates, Explanation
from pipeline.scheduling.topology import Sync

#: Gaps that vary by less than this share of the stream's period come from locked clocks, and their
#: median is an offset between what the two stamps mean.
_LOCKED = 0.2
#: Triggers that a suggestion needs.
_ENOUGH = 10


@dataclass(frozen=True, slots=True)
class Suggestion:
    """For one edge of a nearest input; ms."""

    input: str
    source: str
    tolerance_ms: float
    offset_ms: float
    max_wait_ms: float | None
    suggested_tolerance_ms: float
    suggested_offset_ms: float
    suggested_max_wait_ms: float
    why: str


def suggestions(explanation: Explanation) -> list[Suggestion]:
    """One for each nearest edge that has said enough."""
    stamps = [story.stamp for story in explanation.triggers]
    arrivals = [explanation.begin + round(story.arrived_s * 1e9) for story in explanation.triggers]
    found = (
        _suggestion(candidates, stamps, arrivals)
        for candidates in explanation.candidates
        if candidates.rule.sync is Sync.NEAREST
    )
    return [one for one in found if one is not None]


def _suggestion(
    candidates: Candidates, stamps: Sequence[int], arrivals: Sequence[int]
) -> Suggestion | None:
    if len(candidates.stamps) < 2:
        return None
    first, last = candidates.stamps[0], candidates.stamps[-1]
    inside = [n for n, stamp in enumerate(stamps) if first <= stamp <= last]
    if len(inside) < _ENOUGH:  # before a stream begins and after it ends, gaps tell nothing
        return None
    stamps, arrivals = [stamps[n] for n in inside], [arrivals[n] for n in inside]
    gaps = np.array([candidates.gap(stamp) / 1e6 for stamp in stamps])
    rule = candidates.rule
    period = float(np.median(np.diff(np.asarray(candidates.stamps, dtype=np.int64)))) / 1e6
    shift, why = _shift(gaps, period)
    apart = np.abs(gaps + shift)
    usual = widest = float(np.quantile(apart, 0.99))
    if usual > period:  # without holes a nearest message is half a period away, at most
        widest = period / 2
        why = (
            f"the stream has holes (its period is {period:.1f} ms, and 1 gap of 100 is above "
            f"{usual:.1f}): half a period is as near as it can promise"
        )
    else:
        why += f"; 99 of 100 are within {usual:.1f} ms"
    waits = _waits(candidates, stamps, arrivals, gaps, apart <= widest)
    return Suggestion(
        input=rule.name,
        source=str(candidates.port),
        tolerance_ms=rule.tolerance / 1e6,
        offset_ms=rule.offset / 1e6,
        max_wait_ms=None if rule.max_wait is None else rule.max_wait / 1e6,
        suggested_tolerance_ms=float(ceil(1.1 * widest + 0.5)),
        suggested_offset_ms=round(rule.offset / 1e6 + shift, 1),
        suggested_max_wait_ms=float(ceil(1.2 * float(np.quantile(waits, 0.99)))) if waits else 0.0,
        why=why,
    )


def _shift(gaps: NDArray[np.float64], period: float) -> tuple[float, str]:
    """What to add to an offset, ms, for the gaps (n,) of a stream of a period, and why."""
    middle = float(np.median(gaps))
    spread = float(np.quantile(gaps, 0.95) - np.quantile(gaps, 0.05))
    if spread < _LOCKED * period and abs(middle) > max(1.0, spread):
        return -middle, (
            f"the gaps hardly vary ({spread:.1f} ms of a period of {period:.1f}): the clocks are "
            f"locked, {abs(middle):.1f} ms apart"
        )
    return 0.0, f"the streams run free: a gap is anything up to half a period of {period:.1f} ms"


def _waits(
    candidates: Candidates,
    stamps: Sequence[int],
    arrivals: Sequence[int],
    gaps: NDArray[np.float64],
    served: NDArray[np.bool_],
) -> list[float]:
    """How long after its arrival each trigger that is `served` could have been settled, ms: when
    the first message came that is no nearer than the nearest on the far side."""
    waits: list[float] = []
    for stamp, arrived, gap in compress(zip(stamps, arrivals, gaps, strict=True), served):
        far = bisect_left(candidates.stamps, stamp + round(abs(gap) * 1e6))
        if far < len(candidates.arrivals):
            waits.append(max(0.0, (candidates.arrivals[far] - arrived) / 1e6))
    return waits
