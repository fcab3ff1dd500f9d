"""What the pictures of a map have in common: which voxels they show, and in which colors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.message import Message
from stages.kernels.compiled import as_input
from stages.kernels.neighbors import Cubes, nearest
from stages.kernels.probability import read_out
from stages.sinks.last_map import LastMap, chosen
from stages.taxonomy import load_taxonomy
from stages.types import SemanticVoxels

#: A few scans hit a parked car at least so densely, m; as long a trail is left behind a walker.
REACH_M = 0.75


class DrawnMap(LastMap):
    """A picture of the last map, written when the stage closes.

    A map keeps all that it has seen, so a person who walked by is a wall in it. With `recent`, a
    map of the last few scans, what can move by itself (persons, vehicles) is drawn only where
    something of the kind still is.
    """

    def process(
        self, map: Message[SemanticVoxels], recent: Message[SemanticVoxels] | None = None
    ) -> None:
        super().process(map)
        self._recent = recent.payload if recent else None

    def close(self) -> None:
        if self._last is not None and self._recent is not None:
            self._last = without_trails(self._last, self._recent)
            self._recent = None
        super().close()


def without_trails(voxels: SemanticVoxels, recent: SemanticVoxels) -> SemanticVoxels:
    """The map without voxels of what can move that are far from any such voxel of `recent`."""
    dynamic = load_taxonomy().dynamic
    moving = recent.positions[dynamic[classes_of(recent)]]
    near = nearest(Cubes.of(moving, REACH_M), voxels.positions) >= 0
    return chosen(voxels, near | ~dynamic[classes_of(voxels)])


def in_colors(
    voxels: SemanticVoxels,
) -> tuple[NDArray[np.bool_], NDArray[np.uint8], NDArray[np.uint8]]:
    """Which voxels (n,) to draw, the classes (k,) of those, and the colors (classes, 3).

    Background and sky are left out. The ground is paled, so that cars stand out on the road, whose
    color is almost theirs.
    """
    taxonomy = load_taxonomy()
    label = classes_of(voxels)
    kept = ~np.isin(label, [0, taxonomy.id("sky")])
    paled = taxonomy.colors // 2 + 127
    colors = np.where(taxonomy.ground[:, None], paled, taxonomy.colors).astype(np.uint8)
    return kept, label[kept], colors


def legend(
    label: NDArray[np.uint8], colors: NDArray[np.uint8]
) -> list[tuple[str, tuple[int, int, int]]]:
    """Name and color of the classes present."""
    names = load_taxonomy().names
    return [(names[k], tuple(colors[k].tolist())) for k in np.unique(label)]


def classes_of(voxels: SemanticVoxels) -> NDArray[np.uint8]:
    """(n,) the likeliest class of each voxel."""
    label: NDArray[np.uint8] = read_out(as_input(voxels.log_scores), len(load_taxonomy()))[0]
    return label
