"""The ground in a map, as planes by tile: what lies on it and is no ground was labeled wrong.

Label propagation needs it (Bultmann et al., section 3.5): a camera smears the class of a car's
lower edge over the road beside it, and a plane knows better.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Draws of three points; with a third of the candidates on the ground, 1 of 250 fits misses it.
DRAWS = 150
#: Least part of a tile's candidates that a plane holds, and least candidates to look for one.
LEAST_SHARE, LEAST_POINTS = 0.3, 30
#: A tile's own plane may lie so far from the whole map's, m: slopes and curbs, no roofs.
TILE_REACH_M = 3.0


def lowest_in_columns(positions: NDArray[np.float32], column_m: float = 0.5) -> NDArray[np.int64]:
    """Rows of the lowest of the positions (n, 3) in each column of the map, by z."""
    cells = np.floor(positions[:, :2] / column_m).astype(np.int64)
    order = np.lexsort((positions[:, 2], cells[:, 1], cells[:, 0]))
    sorted_cells = cells[order]
    first = np.ones(len(order), dtype=np.bool_)
    first[1:] = (sorted_cells[1:] != sorted_cells[:-1]).any(axis=1)
    return np.asarray(order[first], dtype=np.int64)


def fit_plane(
    points: NDArray[np.float64],
    *,
    reach_m: float = 0.2,
    largest_tilt_deg: float = 10.0,
    seed: int = 0,
) -> NDArray[np.float64] | None:
    """(4,) a unit normal that points up and an offset, so that normal . p + offset is the height of
    p above the plane: RANSAC over points (n, 3), then least squares over those within `reach_m`.

    The normal is within `largest_tilt_deg` of z. None where no plane holds enough of the points.
    """
    if len(points) < LEAST_POINTS:
        return None
    random = np.random.default_rng(seed)
    steepest = np.cos(np.radians(largest_tilt_deg))
    # Numbers get small where the points are: far from the map's origin a product would lose digits.
    center = points.mean(axis=0)
    local = points - center
    best, most = None, 0
    for _ in range(DRAWS):
        a, b, c = local[random.choice(len(local), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length < 1e-9 or abs(normal[2]) < steepest * length:
            continue
        normal = normal / (length * np.sign(normal[2]))
        inside = abs((local - a) @ normal) <= reach_m
        if (count := int(np.count_nonzero(inside))) > most:
            best, most = inside, count
    if best is None or most < LEAST_SHARE * len(points):
        return None
    x, y, z = local[best].T
    (slope_x, slope_y, height), *_ = np.linalg.lstsq(
        np.stack([x, y, np.ones_like(x)], axis=1), z, rcond=None
    )
    normal = np.array([-slope_x, -slope_y, 1.0]) / np.sqrt(slope_x**2 + slope_y**2 + 1)
    if normal[2] < steepest:
        return None
    return np.append(normal, -normal[2] * height - normal @ center)


def heights(
    positions: NDArray[np.float32],
    *,
    tile_m: float | None = 20.0,
    reach_m: float = 0.2,
    largest_tilt_deg: float = 10.0,
) -> NDArray[np.float64]:
    """(n,) of the positions (n, 3) of a map, z up, the height above the ground, m; NaN where no
    ground was found.

    Candidates are the lowest in each column. The plane of the whole map comes first; with `tile_m`
    each tile has its own, of the candidates near that plane, and takes the whole one where it has
    too few. The same map gives the same planes.
    """
    result = np.full(len(positions), np.nan)
    candidates = lowest_in_columns(positions)
    points = positions[candidates].astype(np.float64)
    whole = (
        fit_plane(points, reach_m=max(reach_m, 0.2), largest_tilt_deg=largest_tilt_deg)
        if tile_m is None
        else _widest_plane(points, largest_tilt_deg)
    )
    if whole is not None:
        result = positions @ whole[:3] + whole[3]
    if tile_m is None:
        return result
    near = np.ones(len(points), dtype=np.bool_)
    if whole is not None:
        near = abs(points @ whole[:3] + whole[3]) <= TILE_REACH_M
    tiles = np.floor(positions[:, :2] / tile_m).astype(np.int64)
    _, tile = np.unique(tiles, axis=0, return_inverse=True)
    tile = tile.reshape(-1)
    tile_of_candidate = tile[candidates]
    for number in range(int(tile.max(initial=-1)) + 1):
        chosen = points[near & (tile_of_candidate == number)]
        plane = fit_plane(chosen, reach_m=reach_m, largest_tilt_deg=largest_tilt_deg, seed=number)
        if plane is not None:
            here = tile == number
            result[here] = positions[here] @ plane[:3] + plane[3]
    return result


def _widest_plane(
    points: NDArray[np.float64], largest_tilt_deg: float
) -> NDArray[np.float64] | None:
    """A plane for a map that is none: of the reaches that are tried the least that holds enough."""
    for reach_m in (0.2, 0.5, 1.0):
        plane = fit_plane(points, reach_m=reach_m, largest_tilt_deg=largest_tilt_deg)
        if plane is not None:
            return plane
    return None


def without_smear(
    labels: NDArray[np.uint8],
    height_m: NDArray[np.float64],
    ground: NDArray[np.bool_],
    reach_m: float = 0.2,
) -> NDArray[np.uint8]:
    """The labels (n,) with 0 where one lies on the ground, within `reach_m` of it, and its class,
    by `ground` (classes,), cannot be ground. Where no ground is known (NaN) they stay."""
    on_plane = abs(height_m) <= reach_m
    return np.where(on_plane & ~ground[labels], 0, labels).astype(np.uint8)
