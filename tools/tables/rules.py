"""Labels without a network: what a reader has to know of any table before he believes a network."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from stages.kernels.ground import fit_plane, lowest_in_columns
from stages.taxonomy import load_taxonomy

#: Heights above the ground that are tried as the road's, m.
THRESHOLDS_M = (0.10, 0.15, 0.20, 0.25, 0.35)


def height_above_ground(points: NDArray[np.float32]) -> NDArray[np.float64]:
    """(n,) of the points (n, 3) of a scan the height above its ground plane, m; without one, above
    the lowest points."""
    near = points[np.linalg.norm(points[:, :2], axis=1) < 25]
    candidates = near[lowest_in_columns(near)].astype(np.float64)
    plane = fit_plane(candidates, reach_m=0.15)
    if plane is None:
        return np.asarray(points[:, 2] - np.quantile(points[:, 2], 0.05), dtype=np.float64)
    return np.asarray(points @ plane[:3] + plane[3], dtype=np.float64)


def rules() -> Mapping[str, tuple[tuple[float, str], ...]]:
    """Height rules by name: (below this height, this class) in turn."""
    two = {
        f"road below {limit:.2f} m, vegetation above": ((limit, "road"), (np.inf, "vegetation"))
        for limit in THRESHOLDS_M
    }
    four = {
        f"road below {limit:.2f} m, vehicle, vegetation, building": (
            (limit, "road"),
            (1.6, "vehicle"),
            (2.5, "vegetation"),
            (np.inf, "building"),
        )
        for limit in THRESHOLDS_M
    }
    return {**two, **four}


def by_height(
    height_m: NDArray[np.float64], rule: tuple[tuple[float, str], ...]
) -> NDArray[np.int64]:
    """(n,) the class that the rule gives to each height."""
    taxonomy = load_taxonomy()
    limits = np.array([limit for limit, _ in rule[:-1]])
    classes = np.array([taxonomy.id(name) for _, name in rule])
    return np.asarray(classes[np.searchsorted(limits, height_m, side="right")], dtype=np.int64)
