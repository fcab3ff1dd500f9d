"""Boxes of detectors: from their outputs to pixels of the image, without duplicates.

A decoder returns boxes (n, 4) x0 y0 x1 y1 in parts of the network's picture (0..1, y down), classes
(n,) in the network's numbering and scores (n,) 0..1, only those scored at least `min_score`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled

Boxes: TypeAlias = NDArray[np.float32]
Found: TypeAlias = tuple[Boxes, NDArray[np.int64], NDArray[np.float32]]


def decode_detection_output(rows: NDArray[np.float32], min_score: float) -> Found:
    """OpenVINO's DetectionOutput (n, 7): image, class, score, x0, y0, x1, y1; image -1 ends it."""
    ends = np.flatnonzero(rows[:, 0] < 0)
    rows = rows[: ends[0]] if len(ends) else rows
    rows = rows[rows[:, 2] >= min_score]
    return rows[:, 3:7].astype(np.float32), rows[:, 1].astype(np.int64), rows[:, 2]


def decode_fastestdet(grid: NDArray[np.float32], min_score: float) -> Found:
    """FastestDet's grid (rows, columns, 5 + classes): objectness, x, y, w, h, class probabilities.

    Score = objectness^0.6 * class^0.4, center = (cell + tanh x) / cells, size = sigmoid w.
    """
    rows, columns = grid.shape[:2]
    probabilities = grid[..., 5:]
    best = probabilities.argmax(axis=-1)
    likely = np.take_along_axis(probabilities, best[..., None], axis=-1)[..., 0]
    # An 8-bit file can give a hair below zero.
    scores = np.maximum(grid[..., 0], 0) ** 0.6 * np.maximum(likely, 0) ** 0.4
    row, column = np.nonzero(scores >= min_score)
    cells = grid[row, column]
    center_x = (column + np.tanh(cells[:, 1])) / columns
    center_y = (row + np.tanh(cells[:, 2])) / rows
    half_w, half_h = 0.5 / (1 + np.exp(-cells[:, 3])), 0.5 / (1 + np.exp(-cells[:, 4]))
    boxes = [center_x - half_w, center_y - half_h, center_x + half_w, center_y + half_h]
    return (
        np.stack(boxes, axis=1).astype(np.float32),
        best[row, column].astype(np.int64),
        scores[row, column].astype(np.float32),
    )


def ssd_anchors(maps: Sequence[int], scales: Sequence[float]) -> NDArray[np.float32]:
    """(n, 4) center y, center x, height, width of an SSD's anchors, in parts of the picture.

    Order: map, row, column, anchor. A map of scale s has ratios 1, 2, 1/2, 3, 1/3 and sqrt(s * next
    scale) with ratio 1; the first map has 0.1 with ratio 1, s with 2 and s with 1/2.
    """
    following = [*scales[1:], 1.0]
    anchors = []
    for number, (size, scale, then) in enumerate(zip(maps, scales, following, strict=True)):
        if number == 0:
            forms = [(0.1, 1.0), (scale, 2.0), (scale, 0.5)]
        else:
            forms = [(scale, ratio) for ratio in (1.0, 2.0, 0.5, 3.0, 1 / 3)]
            forms.append((float(np.sqrt(scale * then)), 1.0))
        shapes = np.array([(s / np.sqrt(ratio), s * np.sqrt(ratio)) for s, ratio in forms])
        centers = (np.indices((size, size)).transpose(1, 2, 0).reshape(-1, 2) + 0.5) / size
        cells = np.repeat(centers, len(forms), axis=0), np.tile(shapes, (len(centers), 1))
        anchors.append(np.hstack(cells))
    return np.concatenate(anchors).astype(np.float32)


def decode_ssd(
    regression: NDArray[np.float32],
    logits: NDArray[np.float32],
    anchors: NDArray[np.float32],
    min_score: float,
) -> Found:
    """SSD: regression (n, 4) ty tx th tw with variances 10 10 5 5, logits (n, 1 + classes), class 0
    being "nothing"; score = sigmoid. One result per anchor: its best class."""
    best = logits[:, 1:].argmax(axis=1) + 1
    scores = 1 / (1 + np.exp(-np.take_along_axis(logits, best[:, None], axis=1)[:, 0]))
    keep = np.flatnonzero(scores >= min_score)
    ty, tx, th, tw = regression[keep].T
    ya, xa, ha, wa = anchors[keep].T
    y, x = ty / 10 * ha + ya, tx / 10 * wa + xa
    half_h, half_w = 0.5 * ha * np.exp(th / 5), 0.5 * wa * np.exp(tw / 5)
    boxes = np.stack([x - half_w, y - half_h, x + half_w, y + half_h], axis=1)
    return boxes.astype(np.float32), best[keep], scores[keep].astype(np.float32)


def to_image(
    boxes: Boxes, picture: tuple[int, int], placement: NDArray[np.float64], size: tuple[int, int]
) -> Boxes:
    """Boxes in parts of a `picture` (width, height) as pixels of the image it was made of.

    Clipped to the image's `size` (width, height). `placement` is `network_input.placement`'s.
    """
    corners = boxes.reshape(-1, 2, 2) * np.array(picture)
    corners = (corners - placement[2:]) / placement[:2]
    return np.asarray(np.clip(corners, 0, size).reshape(-1, 4), dtype=np.float32)


@compiled
def suppress(
    boxes: Boxes, classes: NDArray[np.int64], scores: NDArray[np.float32], max_iou: float
) -> NDArray[np.int64]:
    """Greedy non-maximum suppression per class: the kept boxes' indices, best score first.

    A box falls when a better one of its class overlaps it by more than `max_iou` (intersection over
    union). Equal scores keep their order.
    """
    order = np.argsort(-scores, kind="mergesort")
    area = np.maximum(boxes[:, 2] - boxes[:, 0], 0) * np.maximum(boxes[:, 3] - boxes[:, 1], 0)
    kept = np.empty(len(order), dtype=np.int64)
    count = 0
    for candidate in order:
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
    return kept[:count].copy()
