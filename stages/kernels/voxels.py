"""How a sparse voxel map is addressed: keys, their open-addressing table, and its bounds.

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

#: A point's log scores are held above their own maximum by this: no class is ruled out for ever.
LOG_LEAST = np.float32(np.log(1e-6))
REACH = 1 << 20


@compiled
def spread(key: Any) -> Any:
    """Fibonacci hashing with a fold: enough for keys that differ in their low bits."""
    h = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    h ^= h >> np.uint64(32)
    return h * np.uint64(0xD6E8FEB86659FD93) >> np.uint64(20)


@compiled
def index_keys(keys: NDArray[np.int64], used: int, table: NDArray[np.int32]) -> None:
    """Fill an all-zero `table` (power of two,) with the slots of the first `used` keys."""
    mask = np.uint64(len(table) - 1)
    for slot in range(used):
        place = spread(keys[slot]) & mask
        while table[place] != 0:
            place = (place + np.uint64(1)) & mask
        table[place] = slot + 1


def unpack(keys: NDArray[np.int64]) -> NDArray[np.int32]:
    """Voxel indices (n, 3) of keys (n,)."""
    axes = np.stack([keys >> 42, (keys >> 21) & 0x1FFFFF, keys & 0x1FFFFF], axis=1)
    return np.asarray(axes - REACH, dtype=np.int32)


def pack(indices: NDArray[np.int32]) -> NDArray[np.int64]:
    """Keys (n,) of voxel indices (n, 3) within `REACH`."""
    x, y, z = (indices.astype(np.int64) + REACH).T
    return np.asarray(x << 42 | y << 21 | z, dtype=np.int64)
