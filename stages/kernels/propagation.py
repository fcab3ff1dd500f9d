"""Label propagation (Bultmann et al., section 3.5): what the map says of the points of a scan.

The labels of voxels are looked up for every point of every scan, also of those that no camera saw.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import as_input
from stages.kernels.horizon import find, voxel_keys
from stages.kernels.probability import read_out


def confident_labels(
    log_scores: NDArray[np.float32],
    classes: int,
    least: float,
    never: Collection[int] = (),
) -> NDArray[np.uint8]:
    """(n,) the likeliest class of each row (n, 16), 0 where its probability is below `least` or it
    is one of `never`: what no return of a LiDAR can be."""
    label, confidence, _ = read_out(as_input(log_scores), classes)
    kept = (confidence >= np.float32(least)) & ~np.isin(label, list(never))
    return np.where(kept, label, 0).astype(np.uint8)


def slots_of_points(
    points: NDArray[np.float32],
    wanted: NDArray[np.bool_],
    map_from_sensor: NDArray[np.float64],
    voxel_m: float,
    table: NDArray[np.int32],
    keys: NDArray[np.int64],
) -> NDArray[np.int32]:
    """(n,) the map's slot of each of the points (n, 3) that is `wanted` (n,), -1 where it has none.

    `table` and `keys` as `stages.kernels.voxels` lays them out.
    """
    x, y, z = as_input(points.T)
    pose = as_input(np.asarray(map_from_sensor, dtype=np.float64))
    voxels, _ = voxel_keys(x, y, z, as_input(wanted), pose, voxel_m)
    slots, _ = find(voxels, as_input(table), as_input(keys))
    return np.asarray(slots)


def looked_up(labels: NDArray[np.uint8], slots: NDArray[np.int32]) -> NDArray[np.uint8]:
    """(n,) the label of each point's slot (n,), of the labels by slot (m,); 0 without a slot."""
    if len(labels) == 0:
        return np.zeros(len(slots), dtype=np.uint8)
    return np.where(slots >= 0, labels[slots], 0).astype(np.uint8)
