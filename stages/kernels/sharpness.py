"""How sharp a semantic map is, measured on the map alone: no truth, no rays, no second run.

Poses that are off smear what is flat and disagree about what is where. So three measures per class:
how thick its surfaces are (m; the plane variance of Droeschel and Behnke's map evaluation, as a
length), how unsure its voxels are (nats), and into how many blobs they fall. Thickness is the one
to compare maps by: it has a unit that a person can judge, needs no classes, and depends neither on
how many voxels there are nor on how sure a network is of itself, which entropy does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.kernels.neighbors import Cubes, blobs, thickness

#: A neighborhood reaches so many voxels around a voxel: a wall three voxels thick still fits in.
REACH_VOXELS = 3.0

#: Fewer neighbors span no surface.
LEAST_NEIGHBORS = 8

#: Smaller groups of voxels are specks, not blobs.
LEAST_BLOB = 10

#: A voxel is disputed from this entropy on (nats): two classes with 90 to 10 % have it.
DISPUTED_NATS = 0.325


@dataclass(frozen=True, slots=True)
class Sharpness:
    """Of a map or of one class in it."""

    voxels: int
    thickness_m: float  #: mean over voxels that have neighbors enough; NaN without any
    disputed: float  #: share of the voxels with an entropy of `DISPUTED_NATS` or more; NaN: unknown
    entropy: float  #: mean, nats; NaN: unknown
    blobs: int  #: connected groups of at least `LEAST_BLOB` voxels


def sharpness(
    points: NDArray[np.float64],
    labels: NDArray[np.int64],
    entropy: NDArray[np.float32] | None,
    voxel_m: float,
) -> tuple[Sharpness, dict[int, Sharpness]]:
    """Of all labeled voxels and of each class, by id.

    `points` (n, 3) mean positions, m; `labels` (n,) 0 unlabeled; `entropy` (n,) nats. A surface's
    neighbors are those of its own class, so that a curb or a wheel on the road thickens nothing.
    """
    voxels = np.floor(points / voxel_m).astype(np.int64)
    thick = np.full(len(points), np.nan)
    groups = np.full(len(points), -1, dtype=np.int64)
    present = [int(label) for label in np.unique(labels[labels > 0])]
    for label in present:
        own = labels == label
        thick[own] = thickness(Cubes.of(points[own], REACH_VOXELS * voxel_m), LEAST_NEIGHBORS)
        groups[own] = blobs(voxels[own])

    def measure(own: NDArray[np.bool_]) -> Sharpness:
        known = thick[own & np.isfinite(thick)]
        nats = np.full(int(own.sum()), np.nan) if entropy is None else entropy[own]
        sizes = [np.bincount(groups[own & (labels == label)]) for label in present]
        return Sharpness(
            voxels=int(own.sum()),
            thickness_m=float(known.mean()) if len(known) else float("nan"),
            disputed=_share(nats >= DISPUTED_NATS) if entropy is not None else float("nan"),
            entropy=float(nats.mean()) if len(nats) else float("nan"),
            blobs=sum(int(np.count_nonzero(size >= LEAST_BLOB)) for size in sizes),
        )

    return measure(labels > 0), {label: measure(labels == label) for label in present}


def _share(mask: NDArray[np.bool_]) -> float:
    return float(mask.mean()) if len(mask) else float("nan")
