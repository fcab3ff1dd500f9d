"""Ground truth of an image: the boxes around what a camera sees."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled
from stages.labels import Labels
from stages.taxonomy import load_taxonomy
from stages.types import Detections

#: Classes that detectors know.
BOXED = ("person", "rider", "bicycle", "vehicle")
#: A box is kept from this many visible pixels on; of fewer, nobody would draw one.
MIN_PIXELS = 24


def visible_boxes(labels: Labels) -> Detections:
    """The boxes around the visible pixels of every person, rider, bicycle and vehicle."""
    return visible_things(labels)[0]


def visible_things(labels: Labels) -> tuple[Detections, NDArray[np.int64]]:
    """The same, and the thing (n,) that each box is around."""
    taxonomy = load_taxonomy()
    boxed = np.zeros(256, dtype=np.bool_)
    boxed[[taxonomy.id(name) for name in BOXED]] = True
    count = int(labels.instances.max(initial=0)) + 1
    extents, pixels, classes = _extents(labels.instances, labels.classes, count)
    keep = boxed[classes] & (pixels >= MIN_PIXELS)
    boxes = Detections(
        boxes=extents[keep].astype(np.float32),
        classes=classes[keep].astype(np.int64),
        scores=np.ones(int(keep.sum()), dtype=np.float32),
        camera=labels.sensor,
    )
    return boxes, np.flatnonzero(keep)


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
