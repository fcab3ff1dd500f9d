"""The semantic map's arithmetic (eq 8-17) with a horizon: merge a scan, fold it in, take it out.

A scan is first merged by voxel (its points multiply, as in one entry of the paper's deque); the map
then takes one row per voxel. Normalization is deferred: a constant per voxel changes no later
product and no posterior, so only what would overflow is ever subtracted.

What shall leave the map again is kept in whole numbers (1/1024 nat), so that adding and subtracting
is exact: an `entry` is a row of 20 int32, the 16 channels' log scores, the sums of x, y, z from the
voxel's corner in 1/1024 of its edge, and the number of points.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled, prefetch, prefetch_to_write
from stages.kernels.voxels import FLOOR, LOG_LEAST, REACH, spread

ENTRY = 20
UNITS = 1024.0  #: per nat, and per edge of a voxel

#: So many points or voxels ahead their rows are asked for: about as long as memory takes.
AHEAD = 32

#: The most scans in a window: 31 rows of at most 2^26 each fit an int32.
MAX_WINDOW = 31
MAX_POINTS = 65_536  #: points per voxel and scan that count for its mean position


@compiled
def voxel_keys(
    xs: NDArray[np.float32],
    ys: NDArray[np.float32],
    zs: NDArray[np.float32],
    evidence: NDArray[np.bool_],
    map_from_sensor: NDArray[np.float64],
    voxel_m: float,
) -> Any:
    """The voxel of each point, as `voxels` packs it: keys (n,) int64, -1 without evidence, -2 out
    of the map's reach; and the point in its voxel (n, 3) float32, 0..1 of the edge.
    """
    n = len(xs)
    keys = np.empty(n, dtype=np.int64)
    inside = np.empty((n, 3), dtype=np.float32)
    t = map_from_sensor / voxel_m
    reach = np.float64(REACH)
    for i in range(n):
        x = t[0, 0] * xs[i] + t[0, 1] * ys[i] + t[0, 2] * zs[i] + t[0, 3]
        y = t[1, 0] * xs[i] + t[1, 1] * ys[i] + t[1, 2] * zs[i] + t[1, 3]
        z = t[2, 0] * xs[i] + t[2, 1] * ys[i] + t[2, 2] * zs[i] + t[2, 3]
        reached = (abs(x) < reach) & (abs(y) < reach) & (abs(z) < reach)
        x, y, z = x if reached else 0.0, y if reached else 0.0, z if reached else 0.0
        fx, fy, fz = np.floor(x), np.floor(y), np.floor(z)
        key = (np.int64(fx) + REACH) << 42 | (np.int64(fy) + REACH) << 21 | (np.int64(fz) + REACH)
        keys[i] = key if reached else -2
        keys[i] = keys[i] if evidence[i] else -1
        inside[i, 0], inside[i, 1], inside[i, 2] = x - fx, y - fy, z - fz
    return keys, inside


@compiled
def merge_scan(
    keys: NDArray[np.int64],
    inside: NDArray[np.float32],
    log_scores: NDArray[np.float32],
    classes: int,
    mean: bool,
) -> Any:
    """Multiply the points of a scan by voxel.

    `keys`, `inside` from `voxel_keys`, `log_scores` (n, 16) held above their own maximum + log
    1e-6: no point vetoes a class forever, and a NaN is as little as there is. A row without a
    finite maximum says nothing (uniform). With `mean` the geometric mean of the points, not their
    product.

    Returns by voxel in the order of the first hit: keys (m,) int64, rows (m, 16) float32 with
    maximum 0 and 0 from `classes` on, sums of `inside` (m, 3) float32, and numbers of points (m,)
    int32, the last two over the first `MAX_POINTS` points of a voxel.
    """
    n = len(keys)
    size = 16
    while size < 2 * n:
        size *= 2
    mask = np.uint64(size - 1)
    table = np.zeros(size, dtype=np.int32)  # voxel + 1
    voxels = np.empty(n, dtype=np.int64)
    voxel_of = np.empty(n, dtype=np.int32)
    m, key_before = 0, np.int64(-3)
    v: Any = np.int32(0)
    for i in range(n):
        key = keys[i]
        if key < 0:
            continue
        if key != key_before:
            place = spread(key) & mask
            v = table[place] - np.int32(1)
            while v >= 0 and voxels[v] != key:
                place = (place + np.uint64(1)) & mask
                v = table[place] - np.int32(1)
            if v < 0:
                v = np.int32(m)
                m += 1
                table[place] = m
                voxels[v] = key
            key_before = key
        voxel_of[i] = v
    rows = np.zeros((m, 16), dtype=np.float32)
    sums = np.zeros((m, 3), dtype=np.float32)
    counts = np.zeros(m, dtype=np.int32)
    for i in range(n):
        prefetch(log_scores, (i + AHEAD) * 16)
        if i + AHEAD < n and keys[i + AHEAD] >= 0:
            prefetch_to_write(rows, voxel_of[i + AHEAD] * 16)
        if keys[i] < 0:
            continue
        slot = np.uint64(voxel_of[i])
        row = log_scores[i]
        top = np.float32(-np.inf)
        for k in range(classes):
            top = row[k] if row[k] > top else top
        if abs(top) < np.float32(np.inf):
            least = top + LOG_LEAST
            for k in range(classes):
                rows[slot, k] += (row[k] if row[k] > least else least) - top
        if counts[slot] < MAX_POINTS:
            counts[slot] += 1
            for k in range(3):
                sums[slot, k] += inside[i, k]
            if counts[slot] % 16 == 0:  # large sums would lose the small differences
                _lift(rows[slot], classes)
    for j in range(m):
        if mean:
            for k in range(classes):
                rows[j, k] /= np.float32(counts[j])
        if counts[j] > 1:  # a single point's maximum is 0 already
            _lift(rows[j], classes)
    return voxels[:m].copy(), rows, sums, counts


@compiled
def _lift(row: NDArray[np.float32], classes: int) -> None:
    """Subtract the row's maximum."""
    top = row[0]
    for k in range(1, classes):
        top = row[k] if row[k] > top else top
    for k in range(classes):
        row[k] -= top


@compiled
def find(voxels: NDArray[np.int64], table: NDArray[np.int32], keys: NDArray[np.int64]) -> Any:
    """Slots (m,) int32 of voxels (m,), -1 for those that the map does not hold, and their number.

    `table` (power of two,) holds slot + 1 at a key's hash, `keys` (c,) the voxel of a slot. The
    first places are read for all voxels, then their keys: many cache misses in flight at once.
    """
    mask = np.uint64(len(table) - 1)
    m = len(voxels)
    slots = np.empty(m, dtype=np.int32)
    missing = 0
    for i in range(m):
        if i + AHEAD < m:
            prefetch(table, spread(voxels[i + AHEAD]) & mask)
        slots[i] = table[spread(voxels[i]) & mask] - np.int32(1)
    for i in range(m):
        if i + AHEAD < m:
            prefetch(keys, max(slots[i + AHEAD], 0))
        slot = slots[i]
        if slot >= 0 and keys[np.uint64(slot)] != voxels[i]:
            place = spread(voxels[i]) & mask
            while slot >= 0 and keys[np.uint64(slot)] != voxels[i]:
                place = (place + np.uint64(1)) & mask
                slot = table[place] - np.int32(1)
            slots[i] = slot
        missing += slot < 0
    return slots, missing


@compiled
def insert(
    voxels: NDArray[np.int64],
    slots: NDArray[np.int32],
    used: int,
    table: NDArray[np.int32],
    keys: NDArray[np.int64],
) -> Any:
    """Give each voxel (m,) whose slot is -1 the next one, in place; returns the slots now used.

    `keys` must have room for them, and `table` stay at most half full.
    """
    mask = np.uint64(len(table) - 1)
    for i in range(len(voxels)):
        if slots[i] < 0:
            place = spread(voxels[i]) & mask
            while table[place] != 0:
                place = (place + np.uint64(1)) & mask
            keys[used] = voxels[i]
            slots[i] = used
            used += 1
            table[place] = used
    return used


@compiled
def fold(
    slots: NDArray[np.int32],
    rows: NDArray[np.float32],
    scores: NDArray[np.float32],
    classes: int,
) -> None:
    """Multiply rows (m, 16) of log scores into voxels `slots` (m,) of `scores` (c, 16), forever.

    Eq 13 with eq 14-17 deferred: L += l, then L -= max L, held above `FLOOR`.
    """
    for i in range(len(slots)):
        if i + AHEAD < len(slots):
            prefetch_to_write(scores, np.int64(slots[i + AHEAD]) * 16)
        slot = np.uint64(slots[i])
        top = np.float32(-np.inf)
        for k in range(classes):
            value = scores[slot, k] + rows[i, k]
            scores[slot, k] = value
            top = value if value > top else top
        for k in range(classes):
            value = scores[slot, k] - top
            scores[slot, k] = value if value > FLOOR else FLOOR


@compiled
def fold_positions(
    slots: NDArray[np.int32],
    sums: NDArray[np.float32],
    counts: NDArray[np.int32],
    means: NDArray[np.float32],
    hits: NDArray[np.int32],
) -> None:
    """Take points (m,) `counts` with `sums` (m, 3) into the running means (c, 3) and hits (c,).

    A running mean: a sum in float32 would lose millimeters beyond 10^5 points. Hits saturate.
    """
    for i in range(len(slots)):
        if i + AHEAD < len(slots):
            prefetch_to_write(means, np.int64(slots[i + AHEAD]) * 3)
            prefetch_to_write(hits, slots[i + AHEAD])
        slot = np.uint64(slots[i])
        total = min(np.int64(hits[slot]) + counts[i], 0x7FFFFFFF)
        share = np.float32(1.0 / total)
        for k in range(3):
            means[slot, k] += (sums[i, k] - means[slot, k] * np.float32(counts[i])) * share
        hits[slot] = total


@compiled
def as_entries(
    rows: NDArray[np.float32], sums: NDArray[np.float32], counts: NDArray[np.int32]
) -> Any:
    """Entries (m, 20) int32 of a merged scan, held above -2^26."""
    entries = np.empty((len(rows), ENTRY), dtype=np.int32)
    units, least = np.float32(UNITS), np.float32(-(2**26))
    for i in range(len(rows)):
        for k in range(16):
            entries[i, k] = np.int32(np.rint(max(rows[i, k] * units, least)))
        for k in range(3):
            entries[i, 16 + k] = np.int32(np.rint(sums[i, k] * units))
        entries[i, 19] = counts[i]
    return entries


@compiled
def add_entries(
    slots: NDArray[np.int32], entries: NDArray[np.int32], sign: int, window: NDArray[np.int32]
) -> None:
    """Add (`sign` 1) or take out (-1) entries (m, 20) of `window` (c, 20); slots of -1 are gone."""
    for i in range(len(slots)):
        if i + AHEAD < len(slots):
            prefetch_to_write(window, np.int64(slots[i + AHEAD]) * ENTRY)
        if slots[i] >= 0:
            slot = np.uint64(slots[i])
            for k in range(ENTRY):
                window[slot, k] += np.int32(sign) * entries[i, k]


@compiled
def push_entries(
    slots: NDArray[np.int32],
    entries: NDArray[np.int32],
    ring: NDArray[np.int32],
    pushed: NDArray[np.int32],
    window: NDArray[np.int32],
) -> Any:
    """Put entries (m, 20) into the voxels' own rings (c, scans, 20); what they push out leaves.

    `pushed` (c,) counts the entries a voxel ever got. Returns the entries that left (m, 20), of
    zeros where the ring was not full.
    """
    scans = ring.shape[1]
    left = np.zeros_like(entries)
    for i in range(len(slots)):
        slot = np.uint64(slots[i])
        place = np.uint64(pushed[slot] % scans)
        full = pushed[slot] >= scans
        pushed[slot] += 1 if pushed[slot] < 2 * scans - 1 else 1 - scans
        for k in range(ENTRY):
            old = ring[slot, place, k] if full else np.int32(0)
            left[i, k] = old
            window[slot, k] += entries[i, k] - old
            ring[slot, place, k] = entries[i, k]
    return left


@compiled
def read_window(window: NDArray[np.int32], scores: NDArray[np.float32], classes: int) -> Any:
    """Log scores (n, 16) float32, maximum 0, held above `FLOOR`, of what windows (n, 20) hold.

    `scores` (n, 16) are multiplied in; (0, 16) for the windows alone.
    """
    n = len(window)
    result = np.empty((n, 16), dtype=np.float32)
    for i in range(n):
        # In whole numbers up to here: a window's sums can be too large for a float32 difference.
        top = window[i, 0]
        for k in range(1, classes):
            top = max(top, window[i, k])
        highest = np.float32(-np.inf)
        for k in range(classes):
            value = np.float32(np.int64(window[i, k]) - top) / np.float32(UNITS)
            if len(scores) > 0:
                value += scores[i, k]
            result[i, k] = value
            highest = max(highest, value)
        for k in range(classes):
            result[i, k] = max(result[i, k] - highest, FLOOR)
        for k in range(classes, 16):
            result[i, k] = np.float32(-1e4)
    return result
