"""A sparse voxel grid of class evidence: an open-addressing hash and the Bayes update (eq 8-17).

A voxel's key packs floor(position / edge) in 21 bits per axis with offset 2^20, so a map reaches
2^20 voxels (262 km at 25 cm) from its origin. Slots are numbered by first hit, which keeps what was
seen together close in memory. The table holds slot + 1 at the key's hash, 0 where empty; its size
is a power of two at least twice the number of voxels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled

#: A voxel's log scores have maximum 0 and are held above this: e^-60 is never seen in a posterior,
#: and a class can come back after as many scans as it lost.
FLOOR = np.float32(-60.0)

LOG_LEAST = np.float32(np.log(1e-6))
REACH = 1 << 20


@compiled
def _hash(key: Any) -> Any:
    """The 64-bit finalizer of MurmurHash3: neighbors spread over the whole table."""
    h = np.uint64(key)
    h ^= h >> np.uint64(33)
    h *= np.uint64(0xFF51AFD7ED558CCD)
    h ^= h >> np.uint64(33)
    h *= np.uint64(0xC4CEB9FE1A85EC53)
    h ^= h >> np.uint64(33)
    return h


@compiled
def rehash(keys: NDArray[np.int64], used: int, table: NDArray[np.int32]) -> None:
    """Fill an all-zero `table` (power of two,) with the slots of the first `used` keys."""
    mask = np.uint64(len(table) - 1)
    for slot in range(used):
        place = _hash(keys[slot]) & mask
        while table[place] != 0:
            place = (place + np.uint64(1)) & mask
        table[place] = slot + 1


@compiled
def integrate(
    points: NDArray[np.float32],
    log_scores: NDArray[np.float32],
    evidence: NDArray[np.bool_],
    map_from_sensor: NDArray[np.float64],
    voxel_m: float,
    classes: int,
    table: NDArray[np.int32],
    keys: NDArray[np.int64],
    scores: NDArray[np.float32],
    means: NDArray[np.float32],
    counts: NDArray[np.int32],
    used: int,
    start: int,
) -> Any:
    """Multiply the points' evidence into their voxels, in place, from point `start` on.

    `points` (n, 3) m, `log_scores` (n, 16), `evidence` (n,), `map_from_sensor` (4, 4). By voxel
    slot: `keys` (c,), `scores` (c, 16), `means` (c, 3) mean position from the voxel's corner in m,
    `counts` (c,); `used` slots are taken. Eq 13 with its normalization (eq 14-17) deferred: a
    constant per voxel changes no later product, so L += l and then L -= max L, held above `FLOOR`;
    the posterior is the soft-max of L. An l is held above its own maximum + log 1e-6.

    Returns the slots now used, the next point (n when done: otherwise grow the arrays and go on),
    and how many points with evidence lay out of the map's reach.
    """
    t = map_from_sensor
    mask = np.uint64(len(table) - 1)
    beyond = 0
    for i in range(start, len(points)):
        if not evidence[i]:
            continue
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        x = (t[0, 0] * px + t[0, 1] * py + t[0, 2] * pz + t[0, 3]) / voxel_m
        y = (t[1, 0] * px + t[1, 1] * py + t[1, 2] * pz + t[1, 3]) / voxel_m
        z = (t[2, 0] * px + t[2, 1] * py + t[2, 2] * pz + t[2, 3]) / voxel_m
        if not (abs(x) < REACH and abs(y) < REACH and abs(z) < REACH):
            beyond += 1
            continue
        ix, iy, iz = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
        key = ((ix + REACH) << 42) | ((iy + REACH) << 21) | (iz + REACH)
        place = _hash(key) & mask
        slot = np.int64(table[place]) - 1
        while slot >= 0 and keys[slot] != key:
            place = (place + np.uint64(1)) & mask
            slot = np.int64(table[place]) - 1
        if slot < 0:
            if used == len(keys):
                return used, i, beyond
            slot = np.int64(used)
            used += 1
            table[place] = used
            keys[slot] = key
            for k in range(16):
                scores[slot, k] = 0.0 if k < classes else np.float32(-1e4)
            for k in range(3):
                means[slot, k] = 0.0
            counts[slot] = 0
        top = log_scores[i, 0]
        for k in range(1, classes):
            top = max(top, log_scores[i, k])
        top_of_voxel = np.float32(-np.inf)
        for k in range(classes):
            scores[slot, k] += max(log_scores[i, k] - top, LOG_LEAST)
            top_of_voxel = max(top_of_voxel, scores[slot, k])
        for k in range(classes):
            scores[slot, k] = max(scores[slot, k] - top_of_voxel, FLOOR)
        counts[slot] += 1
        # A running mean: a sum in float32 would lose millimeters beyond 10^5 points.
        share = 1.0 / counts[slot]
        means[slot, 0] += np.float32(((x - ix) * voxel_m - means[slot, 0]) * share)
        means[slot, 1] += np.float32(((y - iy) * voxel_m - means[slot, 1]) * share)
        means[slot, 2] += np.float32(((z - iz) * voxel_m - means[slot, 2]) * share)
    return used, len(points), beyond


def unpack(keys: NDArray[np.int64]) -> NDArray[np.int32]:
    """Voxel indices (n, 3) of keys (n,)."""
    axes = np.stack([keys >> 42, (keys >> 21) & 0x1FFFFF, keys & 0x1FFFFF], axis=1)
    return np.asarray(axes - REACH, dtype=np.int32)
