"""The labels of a map, to be looked up for the points of a scan."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from stages.kernels.propagation import confident_labels, looked_up, slots_of_points
from stages.kernels.voxels import index_keys, pack
from stages.types import SemanticVoxels


@dataclass(frozen=True, slots=True, eq=False)
class MapIndex:
    """Voxels by key, each with its label."""

    voxel_m: float
    keys: NDArray[np.int64]  #: (m,) by slot
    table: NDArray[np.int32]  #: as `stages.kernels.voxels` lays it out
    labels: NDArray[np.uint8]  #: (m,) 0 unlabeled

    @classmethod
    def of(
        cls,
        voxels: SemanticVoxels,
        classes: int,
        confidence: float,
        never: Collection[int] = (),
        labels: NDArray[np.uint8] | None = None,
    ) -> Self:
        """The voxels whose likeliest class has at least the confidence, or those with `labels`."""
        if labels is None:
            labels = confident_labels(voxels.log_scores, classes, confidence, never)
        keys = pack(voxels.indices)
        size = 16
        while size < 2 * len(keys):
            size *= 2
        table = np.zeros(size, dtype=np.int32)
        index_keys(keys, len(keys), table)
        return cls(voxels.voxel_m, keys, table, labels)

    def slots(
        self,
        points: NDArray[np.float32],
        wanted: NDArray[np.bool_],
        map_from_sensor: NDArray[np.float64],
    ) -> NDArray[np.int32]:
        """(n,) the slot of each of the points (n, 3) that is wanted (n,); -1 where none."""
        args = (map_from_sensor, self.voxel_m, self.table, self.keys)
        return slots_of_points(points, wanted, *args)

    def at(self, slots: NDArray[np.int32]) -> NDArray[np.uint8]:
        """(n,) the labels of slots (n,), 0 where there is none."""
        return looked_up(self.labels, slots)
