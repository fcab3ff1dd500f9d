"""What a recording tells of a sensor's clock: rate, jitter, delay, drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

#: Windows whose least delays a drift is fitted to, and the shortest flight that shows one.
_WINDOWS, _DRIFT_S = 10, 5.0


@dataclass(frozen=True, slots=True)
class Clock:
    """One stream. None where it is too short to tell."""

    stream: str
    messages: int
    rate_hz: float | None
    period_ms: float | None  #: median of the gaps between stamps
    jitter_ms: float | None  #: 99 of 100 gaps differ from the period by less
    longest_gap_ms: float | None
    offset_ms: float | None  #: the least delay from the stamp to the arrival: path and clocks
    delay_ms: float | None  #: its median
    late_ms: float | None  #: 99 of 100 arrive with less delay
    drift_ppm: float | None  #: of the sensor's clock against ours; + loses time


def clock_of(stream: str, stamps: Sequence[int], arrivals: Sequence[int]) -> Clock:
    """Measure a stream; stamps and arrivals in ns, in order."""
    count = len(stamps)
    if count < 2:
        return Clock(stream, count, *(None,) * 8)
    at = np.asarray(stamps, dtype=np.int64)
    gaps = np.diff(at) / 1e6
    delays = (np.asarray(arrivals, dtype=np.int64) - at) / 1e6
    period = float(np.median(gaps))
    return Clock(
        stream=stream,
        messages=count,
        rate_hz=(count - 1) * 1e9 / float(at[-1] - at[0]),
        period_ms=period,
        jitter_ms=float(np.quantile(np.abs(gaps - period), 0.99)),
        longest_gap_ms=float(gaps.max()),
        offset_ms=float(delays.min()),
        delay_ms=float(np.median(delays)),
        late_ms=float(np.quantile(delays, 0.99)),
        drift_ppm=_drift(at / 1e6, delays),
    )


def _drift(at_ms: np.ndarray, delays_ms: np.ndarray) -> float | None:
    """The slope of the least delays: what a path adds varies, its least does not."""
    if at_ms[-1] - at_ms[0] < 1e3 * _DRIFT_S or len(at_ms) < 4 * _WINDOWS:
        return None
    parts = np.array_split(np.arange(len(at_ms)), _WINDOWS)
    least = [part[int(np.argmin(delays_ms[part]))] for part in parts]
    slope = np.polyfit(at_ms[least] - at_ms[0], delays_ms[least], 1)[0]
    return float(slope * 1e6)
