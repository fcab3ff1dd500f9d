"""Which points of a detection's box belong to the object in front, not to what stands behind it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled


@compiled
def points_in_box(pixel: NDArray[np.float32], box: NDArray[np.float32]) -> Any:
    """Rows (j,) int64 of `pixel` (m, 2) u v inside the box x0 y0 x1 y1, pixels, edges included."""
    rows = np.empty(len(pixel), dtype=np.int64)
    count = 0
    for i in range(len(pixel)):
        u, v = pixel[i, 0], pixel[i, 1]
        if u >= box[0] and u <= box[2] and v >= box[1] and v <= box[3]:
            rows[count] = i
            count += 1
    return rows[:count].copy()


def foreground(distance: NDArray[np.float32], depth_m: float) -> NDArray[np.bool_]:
    """Of the points in a box, by distance (j,) in m: those within `depth_m` of the 25 % quantile.

    The quantile is by nearest rank, so it is a real point's distance. No point, no foreground.
    """
    if len(distance) == 0:
        return np.zeros(0, dtype=np.bool_)
    rank = (len(distance) - 1) // 4
    seed = np.partition(distance, rank)[rank]
    return np.asarray(np.abs(distance - seed) <= depth_m)
