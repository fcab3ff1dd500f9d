"""Who is near whom among points: the nearest within a radius, the spread of a neighborhood, blobs.

Points are sorted by cubes whose edge is the radius, so that all neighbors of a point lie in the 27
cubes around its own: nine runs of the sorted points, since cubes stacked along z follow each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import as_input, compiled

#: Cubes along one axis, so that a cube's number fits an int64.
MAX_CUBES = 1 << 20


@dataclass(frozen=True, slots=True, eq=False)
class Cubes:
    """Points sorted by cube."""

    radius_m: float
    count: int  #: points that were given, finite or not
    origin: NDArray[np.float64]  #: (3,) corner of the first cube
    points: NDArray[np.float64]  #: (k, 3) the finite ones by cube
    rows: NDArray[np.int64]  #: (k,) row of each in the points as they were given
    keys: NDArray[np.int64]  #: (k,) its cube, increasing

    @classmethod
    def of(cls, points: NDArray[np.floating[Any]], radius_m: float) -> Cubes:
        """Sort points (n, 3); those that are not finite are nobody's neighbor.

        Raises ValueError where the points lie too far apart for the radius.
        """
        if not radius_m > 0:
            raise ValueError(f"the radius must be above 0, not {radius_m}")
        rows = np.flatnonzero(np.isfinite(points).all(axis=1))
        kept = points[rows].astype(np.float64)
        origin = kept.min(axis=0) if len(kept) else np.zeros(3)
        if len(kept) and np.ptp(kept, axis=0).max() >= radius_m * (MAX_CUBES - 4):
            raise ValueError(f"the points lie too far apart for a radius of {radius_m} m")
        keys = _keys(as_input(kept), origin, radius_m)
        order = np.argsort(keys, kind="stable")
        by_cube = (as_input(array[order]) for array in (kept, rows, keys))
        return cls(radius_m, len(points), origin, *by_cube)


def nearest(cubes: Cubes, wanted: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
    """The row (m,) of the point nearest to each of `wanted` (m, 3); -1 where none is in reach.

    Of points at the same distance the one given first.
    """
    return np.asarray(
        _nearest(
            cubes.points,
            cubes.rows,
            cubes.keys,
            cubes.origin,
            cubes.radius_m,
            as_input(wanted.astype(np.float64)),
        )
    )


def thickness(cubes: Cubes, least: int) -> NDArray[np.float64]:
    """How thick the surface through each point is: (n,) m, in the order the points were given.

    The standard deviation of its neighbors within the radius along the direction in which they vary
    least: the root of the smallest eigenvalue of their covariance. NaN with fewer than `least`
    neighbors, itself among them.
    """
    covariance, count = _covariances(cubes.points, cubes.keys, cubes.origin, cubes.radius_m)
    enough = count >= max(least, 1)
    smallest = np.linalg.eigvalsh(covariance[enough])[:, 0]
    result = np.full(cubes.count, np.nan)
    result[cubes.rows[enough]] = np.sqrt(np.maximum(smallest, 0.0))
    return result


def blobs(voxels: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """Which connected group each voxel (n, 3) is of: (n,), 0 the largest.

    Connected are voxels that touch by a face, an edge or a corner.
    """
    if len(voxels) == 0:
        return np.zeros(0, dtype=np.int64)
    low = voxels.min(axis=0).astype(np.float64)
    if np.ptp(voxels, axis=0).max() >= MAX_CUBES - 4:
        raise ValueError("the voxels lie too far apart")
    keys = _keys(as_input(voxels.astype(np.float64)), low, 1.0)
    order = np.argsort(keys, kind="stable")
    group = np.empty(len(voxels), dtype=np.int64)
    group[order] = _groups(as_input(keys[order]))
    sizes = np.bincount(group)
    rank = np.empty(len(sizes), dtype=np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return rank[group]


@compiled
def _key(a: Any, b: Any, c: Any) -> Any:
    """The number of a cube; the next along z has the next number."""
    return ((a + 2) << 42) + ((b + 2) << 21) + c + 2


@compiled
def _keys(points: NDArray[np.float64], origin: NDArray[np.float64], edge: float) -> Any:
    keys = np.empty(len(points), dtype=np.int64)
    for i in range(len(points)):
        a = np.int64(np.floor((points[i, 0] - origin[0]) / edge))
        b = np.int64(np.floor((points[i, 1] - origin[1]) / edge))
        c = np.int64(np.floor((points[i, 2] - origin[2]) / edge))
        keys[i] = _key(a, b, c)
    return keys


@compiled
def _nearest(
    points: NDArray[np.float64],
    rows: NDArray[np.int64],
    keys: NDArray[np.int64],
    origin: NDArray[np.float64],
    radius: float,
    wanted: NDArray[np.float64],
) -> Any:
    found = np.full(len(wanted), -1, dtype=np.int64)
    for i in range(len(wanted)):
        x, y, z = wanted[i]
        u, v, w = (x - origin[0]) / radius, (y - origin[1]) / radius, (z - origin[2]) / radius
        if not (min(u, v, w) > -2.0 and max(u, v, w) < MAX_CUBES):
            continue
        a, b, c = np.int64(np.floor(u)), np.int64(np.floor(v)), np.int64(np.floor(w))
        best = radius * radius
        for da in range(-1, 2):
            for db in range(-1, 2):
                first = np.searchsorted(keys, _key(a + da, b + db, c - 1))
                last = _key(a + da, b + db, c + 1)
                j = first
                while j < len(keys) and keys[j] <= last:
                    dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
                    square = dx * dx + dy * dy + dz * dz
                    if square < best or (square == best and (found[i] < 0 or rows[j] < found[i])):
                        best = square
                        found[i] = rows[j]
                    j += 1
    return found


@compiled
def _covariances(
    points: NDArray[np.float64], keys: NDArray[np.int64], origin: NDArray[np.float64], radius: float
) -> Any:
    """Of the neighbors of each point, itself among them: covariance (n, 3, 3) and count (n,)."""
    covariance = np.zeros((len(points), 3, 3))
    counts = np.zeros(len(points), dtype=np.int64)
    for i in range(len(points)):
        x, y, z = points[i]
        a = np.int64(np.floor((x - origin[0]) / radius))
        b = np.int64(np.floor((y - origin[1]) / radius))
        c = np.int64(np.floor((z - origin[2]) / radius))
        first, second = np.zeros(3), np.zeros((3, 3))
        offset = np.empty(3)
        count = 0
        for da in range(-1, 2):
            for db in range(-1, 2):
                j = np.searchsorted(keys, _key(a + da, b + db, c - 1))
                last = _key(a + da, b + db, c + 1)
                while j < len(keys) and keys[j] <= last:
                    offset[0] = points[j, 0] - x
                    offset[1] = points[j, 1] - y
                    offset[2] = points[j, 2] - z
                    square = offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2
                    if square <= radius * radius:
                        count += 1
                        for row in range(3):
                            first[row] += offset[row]
                            for column in range(3):
                                second[row, column] += offset[row] * offset[column]
                    j += 1
        counts[i] = count
        for row in range(3):
            for column in range(3):
                mean = first[row] * first[column] / (count * count)
                covariance[i, row, column] = second[row, column] / count - mean
    return covariance, counts


@compiled
def _groups(keys: NDArray[np.int64]) -> Any:
    """Groups of neighboring cubes among `keys` (n,), increasing: (n,) numbers from 0."""
    group = np.full(len(keys), -1, dtype=np.int64)
    stack = np.empty(len(keys), dtype=np.int64)
    number = 0
    for start in range(len(keys)):
        if group[start] >= 0:
            continue
        group[start] = number
        stack[0], depth = start, 1
        while depth > 0:
            depth -= 1
            key = keys[stack[depth]]
            for da in range(-1, 2):
                for db in range(-1, 2):
                    middle = key + (da << 42) + (db << 21)
                    j = np.searchsorted(keys, middle - 1)
                    while j < len(keys) and keys[j] <= middle + 1:
                        if group[j] < 0:
                            group[j] = number
                            stack[depth] = j
                            depth += 1
                        j += 1
        number += 1
    return group
