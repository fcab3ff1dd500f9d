"""Automatic gain control: 16-bit thermal frames as 8-bit ones that networks and people can read.

A gain table (65536,) float32 says what becomes of each count. Dead pixels, which read 0 or 65535,
never take part in choosing it.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

COUNTS = 65536

#: What a frame without any contrast becomes.
MIDDLE = 128.0


def histogram(raw: NDArray[np.uint16]) -> NDArray[np.int64]:
    """(65536,) pixels per count; dead pixels (0 and 65535) count nowhere."""
    counts = np.bincount(raw.ravel(), minlength=COUNTS)
    counts[0] = counts[-1] = 0
    return counts


def quantiles(counts: NDArray[np.int64], low: float, high: float) -> tuple[float, float] | None:
    """The counts below which the parts `low` and `high` of the pixels lie; None without pixels."""
    summed = np.cumsum(counts)
    total = int(summed[-1])
    if total == 0:
        return None
    first, last = np.searchsorted(summed, (low * (total - 1), high * (total - 1)), side="right")
    return float(first), float(last)


def linear_table(low: float, high: float) -> NDArray[np.float32]:
    """`low` and below become 0, `high` and above 255; `MIDDLE` throughout where they
    lie less than a count apart."""
    if not high - low >= 1:
        return np.full(COUNTS, MIDDLE, dtype=np.float32)
    ramp = (np.arange(COUNTS, dtype=np.float32) - np.float32(low)) * np.float32(255 / (high - low))
    return np.clip(ramp, 0.0, 255.0, out=ramp)


def plateau_table(
    counts: NDArray[np.int64], plateau: float, max_gain: float
) -> NDArray[np.float32]:
    """Histogram equalization whose bins count at most the part `plateau` of all pixels.

    The plateau keeps a large even surface (sky, ground) from taking all the gray levels. A count
    step becomes at most `max_gain` gray levels, so that a flat scene does not turn into noise; what
    that leaves unused is shared below and above. `MIDDLE` throughout where one count holds all.
    """
    total = int(counts.sum())
    used = np.flatnonzero(counts)
    if len(used) < 2:
        return np.full(COUNTS, MIDDLE, dtype=np.float32)
    bounded = np.minimum(counts, max(plateau * total, 1.0))
    # Each bin's middle, so that the two ends of the frame are treated alike.
    middle = np.cumsum(bounded) - 0.5 * bounded
    middle -= middle[used[0]]
    table = np.clip(middle * (255.0 / middle[used[-1]]), 0.0, 255.0)
    steps = np.minimum(np.diff(table, prepend=0.0), max_gain)
    table = np.cumsum(steps)
    table += 0.5 * (255.0 - table[-1])
    return np.asarray(table, dtype=np.float32)


def apply_table(raw: NDArray[np.uint16], table: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The frame (height, width) through a gain table, rounded."""
    return np.asarray(np.rint(table).astype(np.uint8)[raw])


def equalize_locally(frame: NDArray[np.uint8], clip: float, tiles: int) -> NDArray[np.uint8]:
    """Contrast-limited adaptive histogram equalization over `tiles` x `tiles` tiles.

    `clip` is the greatest slope relative to no equalization. A frame of one value stays as it is.
    """
    if frame.size == 0 or frame.min() == frame.max():
        return frame
    equalizer: Any = cv2.createCLAHE(clipLimit=clip, tileGridSize=(tiles, tiles))
    return np.asarray(equalizer.apply(np.ascontiguousarray(frame)), dtype=np.uint8)
