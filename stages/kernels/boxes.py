"""Boxes of detectors: corners, pixels of the image, and no duplicates."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled

#: (n, 4) x0 y0 x1 y1 in parts of the network's picture (0..1, y down) or in pixels.
Boxes: TypeAlias = NDArray[np.float32]

#: What a detector found: boxes in parts of its picture, classes (n,) in its own numbering, -1 where
#: it gave none, and scores (n,). Candidates: they may be weak, NaN or infinite.
Found: TypeAlias = tuple[Boxes, NDArray[np.int64], NDArray[np.float32]]

#: A side of exp(10) anchors or cells covers every picture; more would only overflow.
MOST_LOG_SIZE = 10.0


def from_center(x: Any, y: Any, width: Any, height: Any) -> Boxes:
    """(n, 4) corners of boxes given by their centers and sizes, each (n,)."""
    with np.errstate(over="ignore", invalid="ignore"):  # what is no number here is dropped later
        half_width, half_height = 0.5 * width, 0.5 * height
        corners = [x - half_width, y - half_height, x + half_width, y + half_height]
        return np.stack(corners, axis=1).astype(np.float32)


def exp_size(log_size: Any) -> Any:
    """exp(log_size), finite for every number: bounded by exp(`MOST_LOG_SIZE`)."""
    return np.exp(np.minimum(log_size, MOST_LOG_SIZE))


def class_ids(values: NDArray[Any]) -> NDArray[np.int64]:
    """Classes that a network gives as numbers of any kind; -1 for what is no class."""
    numbers = np.asarray(values, dtype=np.float64)
    sound = (numbers > -0.5) & (numbers < 2**31)
    return np.rint(np.where(sound, numbers, -1.0)).astype(np.int64)


def is_finite(boxes: Boxes, scores: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(n,) which boxes are numbers throughout, neither NaN nor infinite."""
    return np.isfinite(boxes).all(axis=1) & np.isfinite(scores)


def to_image(
    boxes: Boxes, picture: tuple[int, int], placement: NDArray[np.float64], size: tuple[int, int]
) -> Boxes:
    """Boxes in parts of a `picture` (width, height) as pixels of the image it was made of.

    Clipped to the image's `size` (width, height). `placement` is `network_input.placement`'s.
    """
    in_picture = boxes.reshape(-1, 2, 2) * np.array(picture, dtype=np.float64)
    corners = (in_picture - placement[2:]) / placement[:2]
    return np.asarray(np.clip(corners, 0, size).reshape(-1, 4), dtype=np.float32)


@compiled
def suppress(
    boxes: Boxes,
    classes: NDArray[np.int64],
    scores: NDArray[np.float32],
    max_iou: float,
    max_boxes: int,
) -> NDArray[np.int64]:
    """Greedy non-maximum suppression per class: the kept boxes' indices, best score first.

    A box falls when a better one of its class overlaps it by more than `max_iou` (intersection over
    union). Equal scores keep their order. It ends with the first `max_boxes`, so the work grows
    with the boxes found, not with their square.
    """
    order = np.argsort(-scores, kind="mergesort")
    area = np.maximum(boxes[:, 2] - boxes[:, 0], 0) * np.maximum(boxes[:, 3] - boxes[:, 1], 0)
    kept = np.empty(min(len(order), max_boxes), dtype=np.int64)
    count = 0
    for candidate in order:
        if count == len(kept):
            break
        free = True
        for other in kept[:count]:
            if classes[other] != classes[candidate]:
                continue
            width = min(boxes[other, 2], boxes[candidate, 2]) - max(
                boxes[other, 0], boxes[candidate, 0]
            )
            height = min(boxes[other, 3], boxes[candidate, 3]) - max(
                boxes[other, 1], boxes[candidate, 1]
            )
            if width <= 0 or height <= 0:
                continue
            shared = width * height
            if shared > max_iou * (area[other] + area[candidate] - shared):
                free = False
                break
        if free:
            kept[count] = candidate
            count += 1
    return kept[:count]
