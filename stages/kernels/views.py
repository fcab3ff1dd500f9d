"""Scans that a LiDAR would take of an aggregated cloud from another place (the paper's Fig 5, 6).

A cloud gathered by a vehicle is seen from above it: eq 18 from the viewpoint, the nearest point of
each cell is kept. What stood still is there in all scans, what moved only in those near in time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import as_input, compiled
from stages.kernels.range_image import project_scan


def seen_in_window(
    classes: NDArray[np.uint8],
    scans: NDArray[np.int32],
    dynamic: NDArray[np.bool_],
    at_scan: int,
    window: int,
) -> NDArray[np.bool_]:
    """(n,) which points of a cloud are there at scan `at_scan`: all of classes that stand still,
    and of `dynamic` (classes,) ones those of the `scans` (n,) at most `window` away."""
    near = abs(scans - at_scan) <= window
    return np.asarray(near | ~dynamic[classes])


def view(
    points: NDArray[np.float32],
    viewpoint_m: NDArray[np.float64],
    size: tuple[int, int],
    elevation_rad: tuple[float, float],
    *,
    max_range_m: float = 50.0,
    point_m: float = 0.0,
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The point of each cell (rows, columns), -1 where none, and all points (n, 3) as seen from the
    viewpoint (3,), its axes those of the cloud.

    `point_m` above 0 takes a point for a disk of that width: a cell whose point lies more than
    half a meter behind a disk that covers it is empty, as the gaps between sparse points near the
    sensor would let it see through walls.
    """
    local = np.ascontiguousarray(points - viewpoint_m.astype(np.float32), dtype=np.float32)
    nearest, _, distance = project_scan(as_input(local), size, elevation_rad, max_range_m)
    if point_m > 0 and len(points):
        pitch = (elevation_rad[1] - elevation_rad[0]) / size[0]
        far = np.where(nearest >= 0, distance[nearest], np.inf).astype(np.float32)
        hidden = _behind(as_input(far), point_m, pitch)
        nearest = np.where(hidden, np.int32(-1), nearest)
    return nearest, local


@compiled
def _behind(far: NDArray[np.float32], point_m: float, pitch_rad: float) -> NDArray[np.bool_]:
    """Which cells lie behind the disk of a neighbor; columns wrap around."""
    rows, columns = far.shape
    hidden = np.zeros((rows, columns), dtype=np.bool_)
    for v in range(rows):
        for u in range(columns):
            r = far[v, u]
            if not r < np.inf:
                continue
            reach = min(int(0.5 * point_m / (r * pitch_rad)), 4)
            for dv in range(-reach, reach + 1):
                for du in range(-reach, reach + 1):
                    w = v + dv
                    if 0 <= w < rows and far[w, (u + du) % columns] > r + 0.5:
                        hidden[w, (u + du) % columns] = True
    return hidden
