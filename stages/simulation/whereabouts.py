"""Where every thing of a district is at a time: how far off is what a camera sees?"""

from __future__ import annotations

import numpy as np

from stages.simulation.district import District
from stages.simulation.mesh import Array, Mesh


class Whereabouts:
    """The middles of all things: of what stands still once, of what moves when asked."""

    def __init__(self, district: District) -> None:
        self._district = district
        count = len(district.classes)
        low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
        _extend(low, high, district.still, np.eye(4))
        self._still = low, high

    def at(self, time_ns: int) -> Array:
        """(things, 3) the middle of each thing's box in the map, m; NaN where it has no surface."""
        low, high = (bound.copy() for bound in self._still)
        cast = self._district.cast
        for part, pose in zip(cast.parts, cast.poses(time_ns / 1e9), strict=True):
            _extend(low, high, part, pose)
        middles = np.full(low.shape, np.nan)
        known = np.isfinite(low[:, 0])
        middles[known] = (low[known] + high[known]) / 2
        return middles


def _extend(low: Array, high: Array, mesh: Mesh, pose: Array) -> None:
    """Widen the boxes (things, 3) by the surfaces of a mesh at a pose (4, 4)."""
    if not mesh.corners:
        return
    points = np.concatenate(mesh.corners).reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]
    things = np.repeat(np.array(mesh.things)[np.concatenate(mesh.surface_of)], 3)
    np.minimum.at(low, things, points)
    np.maximum.at(high, things, points)
