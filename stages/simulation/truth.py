"""Ground truth from the scene itself: boxes of what a camera sees, the labeled voxel map."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled
from stages.labels import LabeledVoxels, Labels
from stages.simulation.mesh import Mesh
from stages.taxonomy import load_taxonomy
from stages.types import Detections

#: Classes that detectors know.
BOXED = ("person", "rider", "bicycle", "vehicle")
#: A box is kept from this many visible pixels on; of fewer, nobody would draw one.
MIN_PIXELS = 24
#: Triangles are sampled at this part of a voxel's edge.
_SAMPLES_PER_VOXEL = 2.5


def visible_boxes(labels: Labels) -> Detections:
    """The boxes around the visible pixels of every person, rider, bicycle and vehicle."""
    taxonomy = load_taxonomy()
    boxed = np.zeros(256, dtype=np.bool_)
    boxed[[taxonomy.id(name) for name in BOXED]] = True
    count = int(labels.instances.max(initial=0)) + 1
    extents, pixels, classes = _extents(labels.instances, labels.classes, count)
    keep = boxed[classes] & (pixels >= MIN_PIXELS)
    return Detections(
        boxes=extents[keep].astype(np.float32),
        classes=classes[keep].astype(np.int64),
        scores=np.ones(int(keep.sum()), dtype=np.float32),
        camera=labels.sensor,
    )


@compiled
def _extents(instances: NDArray[np.uint16], classes: NDArray[np.uint8], count: int) -> Any:
    """Of every instance: x0 y0 x1 y1 (pixel edges about centers), its pixels, its class."""
    boxes = np.zeros((count, 4), dtype=np.int64)
    pixels = np.zeros(count, dtype=np.int64)
    kind = np.zeros(count, dtype=np.uint8)
    for row in range(instances.shape[0]):
        for column in range(instances.shape[1]):
            i = instances[row, column]
            if pixels[i] == 0:
                boxes[i, 0], boxes[i, 1] = column, row
                boxes[i, 2], boxes[i, 3] = column, row
                kind[i] = classes[row, column]
            pixels[i] += 1
            boxes[i, 0] = min(boxes[i, 0], column)
            boxes[i, 2] = max(boxes[i, 2], column)
            boxes[i, 3] = row
    return boxes, pixels, kind


def voxel_truth(
    still: Mesh,
    classes: NDArray[np.uint8],
    track: NDArray[np.float64],
    voxel_m: float = 0.25,
    reach_m: float = 50.0,
) -> LabeledVoxels:
    """The voxels that the surfaces of what stands still pass through, within `reach_m` of the
    track (n, 2); each of the class with the largest share of its surface."""
    corners = np.concatenate(still.corners)
    surface = np.concatenate(still.surface_of)
    kind = classes[np.array(still.things)[surface]]
    low, high = track.min(axis=0) - reach_m, track.max(axis=0) + reach_m
    near = ((corners[..., :2].min(1) < high) & (corners[..., :2].max(1) > low)).all(axis=1)
    keys = _voxel_keys(corners[near], kind[near], low, high, track, voxel_m, reach_m)
    unique, counts = np.unique(keys, return_counts=True)
    voxel, voxel_class = unique >> 4, unique & 15
    # By voxel, the most frequent class last: it is the one that is kept.
    order = np.lexsort((counts, voxel))
    last = np.append(voxel[order][1:] != voxel[order][:-1], True)
    chosen = order[last]
    packed = voxel[chosen]
    offset = 1 << 19
    indices = np.stack([(packed >> s & 0xFFFFF) - offset for s in (40, 20, 0)], axis=1)
    return LabeledVoxels(voxel_m, indices.astype(np.int32), voxel_class[chosen].astype(np.uint8))


@compiled
def _voxel_keys(
    corners: NDArray[np.float64],
    classes: NDArray[np.uint8],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    track: NDArray[np.float64],
    voxel_m: float,
    reach_m: float,
) -> Any:
    """One key per sample of the triangles (n, 3, 3): three indices of 20 bits, a class of 4."""
    step = voxel_m / _SAMPLES_PER_VOXEL
    keys = np.empty(1024, dtype=np.int64)
    count = 0
    for i in range(len(corners)):
        a, u, v = corners[i, 0], corners[i, 1] - corners[i, 0], corners[i, 2] - corners[i, 0]
        across = max(1, int(np.ceil(np.sqrt((u * u).sum()) / step)))
        along = max(1, int(np.ceil(np.sqrt((v * v).sum()) / step)))
        for j in range(across):
            b = (j + 0.33) / across
            for k in range(along):
                c = (k + 0.33) / along
                if b + c > 1.0:
                    break
                x = a[0] + b * u[0] + c * v[0]
                y = a[1] + b * u[1] + c * v[1]
                if x < low[0] or y < low[1] or x > high[0] or y > high[1]:
                    continue
                close = False
                for p in range(len(track)):
                    if (x - track[p, 0]) ** 2 + (y - track[p, 1]) ** 2 < reach_m * reach_m:
                        close = True
                        break
                if not close:
                    continue
                z = a[2] + b * u[2] + c * v[2]
                key = np.int64(0)
                for value in (x, y, z):
                    key = key << 20 | (np.int64(np.floor(value / voxel_m)) + (1 << 19))
                if count == len(keys):
                    grown = np.empty(2 * count, dtype=np.int64)
                    grown[:count] = keys
                    keys = grown
                keys[count] = key << 4 | classes[i]
                count += 1
    return keys[:count]
