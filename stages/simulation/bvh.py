"""A bounding volume hierarchy over triangles, built by the surface-area heuristic.

Built after I. Wald, "On fast construction of SAH-based bounding volume hierarchies" (RT 2007): 16
bins along the widest axis of the centroids, leaves of at most `LEAF` triangles. A node holds the
boxes of both its children, so that one look decides about both.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled

LEAF = 4  #: most triangles in a leaf
BINS = 16


class Bvh(NamedTuple):
    """The tree as plain arrays; node 0 is the root.

    A child >= 0 is a node; a child < 0 is a leaf: ``-child - 1 = 8 * first + count`` of `order`.
    """

    boxes: NDArray[np.float32]  #: (nodes, 12): low xyz and high xyz of the left, of the right child
    children: NDArray[np.int32]  #: (nodes, 2)
    order: NDArray[np.int32]  #: (n,) the items in the order of the leaves


def build(lows: NDArray[np.float32], highs: NDArray[np.float32]) -> Bvh:
    """The hierarchy of n >= 1 boxes, given by their corners (n, 3)."""
    n = len(lows)
    boxes = np.empty((max(n, 1), 12), dtype=np.float32)
    children = np.empty((max(n, 1), 2), dtype=np.int32)
    order = np.arange(n, dtype=np.int32)
    used = _build(lows, highs, ((lows + highs) * np.float32(0.5)), order, boxes, children)
    return Bvh(boxes[:used].copy(), children[:used].copy(), order)


@compiled
def _area(box: NDArray[np.float32]) -> Any:
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return x * y + y * z + z * x


@compiled
def _bounds(
    lows: NDArray[np.float32],
    highs: NDArray[np.float32],
    order: NDArray[np.int32],
    first: int,
    last: int,
    box: NDArray[np.float32],
) -> None:
    box[:3] = np.inf
    box[3:] = -np.inf
    for k in range(first, last):
        i = order[k]
        for axis in range(3):
            box[axis] = min(box[axis], lows[i, axis])
            box[3 + axis] = max(box[3 + axis], highs[i, axis])


@compiled
def _split(
    lows: NDArray[np.float32],
    highs: NDArray[np.float32],
    centers: NDArray[np.float32],
    order: NDArray[np.int32],
    first: int,
    last: int,
) -> Any:
    """Reorder order[first:last] and return the first item of its right part."""
    low = np.full(3, np.inf, dtype=np.float32)
    high = np.full(3, -np.inf, dtype=np.float32)
    for k in range(first, last):
        for axis in range(3):
            low[axis] = min(low[axis], centers[order[k], axis])
            high[axis] = max(high[axis], centers[order[k], axis])
    axis = int(np.argmax(high - low))
    extent = high[axis] - low[axis]
    middle = (first + last) // 2
    if extent <= 0.0:
        return middle
    scale = BINS * 0.9999 / extent
    boxes = np.empty((BINS, 6), dtype=np.float32)
    boxes[:, :3] = np.inf
    boxes[:, 3:] = -np.inf
    counts = np.zeros(BINS, dtype=np.int64)
    for k in range(first, last):
        i = order[k]
        b = int((centers[i, axis] - low[axis]) * scale)
        counts[b] += 1
        for a in range(3):
            boxes[b, a] = min(boxes[b, a], lows[i, a])
            boxes[b, 3 + a] = max(boxes[b, 3 + a], highs[i, a])
    right_cost = np.zeros(BINS, dtype=np.float64)
    grown = boxes[BINS - 1].copy()
    count = 0
    for b in range(BINS - 1, 0, -1):
        count += counts[b]
        for a in range(3):
            grown[a] = min(grown[a], boxes[b, a])
            grown[3 + a] = max(grown[3 + a], boxes[b, 3 + a])
        right_cost[b] = count * _area(grown) if count else np.inf
    grown[:] = boxes[0]
    count = 0
    best, best_cost = 0, np.inf
    for b in range(BINS - 1):
        count += counts[b]
        for a in range(3):
            grown[a] = min(grown[a], boxes[b, a])
            grown[3 + a] = max(grown[3 + a], boxes[b, 3 + a])
        if count:
            cost = count * _area(grown) + right_cost[b + 1]
            if cost < best_cost:
                best, best_cost = b, cost
    left, right = first, last - 1
    while left <= right:
        if int((centers[order[left], axis] - low[axis]) * scale) <= best:
            left += 1
        else:
            order[left], order[right] = order[right], order[left]
            right -= 1
    return left if first < left < last else middle


@compiled
def _build(
    lows: NDArray[np.float32],
    highs: NDArray[np.float32],
    centers: NDArray[np.float32],
    order: NDArray[np.int32],
    boxes: NDArray[np.float32],
    children: NDArray[np.int32],
) -> Any:
    """Fill `boxes` and `children`; returns the number of nodes."""
    firsts = np.empty(len(children) + 1, dtype=np.int64)
    lasts = np.empty(len(children) + 1, dtype=np.int64)
    box = np.empty(6, dtype=np.float32)
    firsts[0], lasts[0] = 0, len(order)
    used, node = 1, 0
    while node < used:
        first, last = firsts[node], lasts[node]
        middle = _split(lows, highs, centers, order, first, last) if last - first > 1 else last
        for side in range(2):
            begin, end = (first, middle) if side == 0 else (middle, last)
            _bounds(lows, highs, order, begin, end, box)
            boxes[node, 6 * side : 6 * side + 6] = box
            if end - begin <= LEAF:
                children[node, side] = -(8 * begin + (end - begin)) - 1
            else:
                children[node, side] = used
                firsts[used], lasts[used] = begin, end
                used += 1
        node += 1
    return used
