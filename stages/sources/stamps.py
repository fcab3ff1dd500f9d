"""Stamps for recordings that carry none, and for emulated sensors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from pipeline.stage import Timing

MS = 1_000_000  #: ns


@dataclass(frozen=True, slots=True)
class Stamps:
    """Frame k is stamped offset + k / rate + uniform(-jitter, jitter), ns from the first frame.

    Raises ValueError where the jitter could put two frames in the wrong order.
    """

    rate_hz: float
    offset_ms: float = 0.0
    jitter_ms: float = 0.0
    delay_ms: float = 0.0  #: arrival after the stamp
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.rate_hz > 0:
            raise ValueError(f"rate_hz must be above 0, not {self.rate_hz}")
        if not 0 <= 2 * self.jitter_ms < 1e3 / self.rate_hz:
            raise ValueError(
                f"jitter_ms must be at least 0 and below half a period "
                f"({500 / self.rate_hz:g} ms), not {self.jitter_ms}"
            )
        if not self.delay_ms >= 0:
            raise ValueError(f"delay_ms must not be negative, not {self.delay_ms}")

    def of(self, frames: Iterable[int]) -> Iterator[tuple[int, int]]:
        """(frame, stamp) of each frame; the same seed and frames give the same stamps."""
        random = np.random.default_rng(self.seed)
        for frame in frames:
            jitter_ms = random.uniform(-self.jitter_ms, self.jitter_ms) if self.jitter_ms else 0.0
            yield (
                frame,
                round(frame * 1e9 / self.rate_hz) + round((self.offset_ms + jitter_ms) * MS),
            )

    def arrival(self, stamp: int, end: int | None = None) -> int:
        """When the sample arrives: `delay_ms` after its stamp, never before its capture ends."""
        due = stamp + round(self.delay_ms * MS)
        return due if end is None else max(due, end)

    def last_arrival(self, frames: Iterable[int]) -> int:
        """When the last of some frames, of which there is one, arrives."""
        return max(self.arrival(stamp) for _, stamp in self.of(frames))

    def timing(self) -> Timing:
        """What validation may count on."""
        return Timing(self.rate_hz, self.delay_ms, self.jitter_ms, self.offset_ms)
