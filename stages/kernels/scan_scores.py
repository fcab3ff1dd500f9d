"""A network's answer on a range image back to the points of the scan."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled
from stages.kernels.probability import LEAST

#: The clean-up looks at 5 x 5 cells around a point's own and takes the five nearest in space; what
#: lies further than the cutoff says nothing of the point.
WINDOW = 5
CUTOFF_M = 1.0
#: What a neighbor says weighs 1 / (its distance + this share of the range): nearly the gap between
#: two columns of 512.
SOFTENING = 0.01
#: Where a cell without a return is: out of everybody's reach, and its square is still a float32.
NOWHERE_M = 1e15


@compiled
def rows_by_cell(
    log_scores: NDArray[np.float32],
    nearest: NDArray[np.int32],
    cell: NDArray[np.int32],
    distance: NDArray[np.float32],
    classes: int,
) -> Any:
    """Each point gets what the network says of its cell.

    `log_scores` (rows, columns, 16); `nearest` (rows, columns), `cell` (n,) and `distance` (n,) m
    as `project_scan` gives them. Returns (n, 16) float32 and (n,) bool: the point has a return and
    so has its cell's; else its row is uniform (0).
    """
    scores, point_of = log_scores.reshape(-1, 16), nearest.reshape(-1)
    result = np.empty((len(cell), 16), dtype=np.float32)
    said = np.empty(len(cell), dtype=np.bool_)
    none = np.zeros(16, dtype=np.float32)
    for i in range(len(cell)):
        c = cell[i]
        said[i] = False
        if c >= 0 and distance[i] > 0.0 and point_of[c] >= 0:
            said[i] = distance[point_of[c]] > 0.0
        row = scores[c] if said[i] else none
        for k in range(16):
            result[i, k] = row[k] if k < classes else np.float32(-1e4)
    return result, said


def rows_by_neighbors(
    probabilities: NDArray[np.float32],
    nearest: NDArray[np.int32],
    cell: NDArray[np.int32],
    distance: NDArray[np.float32],
    points: NDArray[np.float32],
    classes: int,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Each point gets a mean of what the network says of the cells nearest to it (kNN).

    Where several points share a cell, or a cell lies across an edge, its class bleeds onto the
    points behind. So of the 5 x 5 cells around a point's own the five whose points are nearest to
    it count, within `CUTOFF_M`, the nearer the more. SalsaNext compares ranges and lets labels
    vote; here probabilities are averaged, as Bayes' rule wants them, and distances compared: along
    a range lie the feet of a person and the street that they stand on. Where none is that near, the
    point's own cell tells it; one whose own cell has no return (of several points one stands for
    the cell) is told by the others alone. Columns go around.

    `probabilities` (rows, columns, 16); `points` (n, 3) m; the rest and the result as
    `rows_by_cell`, as log-probabilities held above log 1e-6.
    """
    stands = np.full((3, *nearest.shape), NOWHERE_M, dtype=np.float32)
    known = nearest >= 0
    known[known] = distance[nearest[known]] > 0.0
    stands[:, known] = points[nearest[known]].T
    half = WINDOW // 2
    padded = np.pad(stands, ((0, 0), (half, half), (0, 0)), constant_values=NOWHERE_M)
    padded = np.concatenate([padded[..., -half:], padded, padded[..., :half]], axis=2)
    mean, said = _mean_of_neighbors(probabilities, padded, cell, distance, points)
    np.maximum(mean, np.float32(LEAST), out=mean)
    if len(mean):
        cv2.log(mean, dst=mean)  # a tenth of the time of np.log
    mean[~said] = 0.0
    mean[:, classes:] = np.float32(-1e4)
    return mean, said


@compiled
def _mean_of_neighbors(
    probabilities: NDArray[np.float32],
    padded: NDArray[np.float32],
    cell: NDArray[np.int32],
    distance: NDArray[np.float32],
    points: NDArray[np.float32],
) -> Any:
    """Points in blocks, so that the search for the five least goes over many points at once.

    `padded` are x, y and z with a border of 2 cells, far away where there is no return. A squared
    gap and the number of its offset share one integer (the 5 low bits of the mantissa: gaps that
    differ by less than 2e-6 of themselves tie), so that keeping the least five sorted is a chain of
    minima and maxima without a branch.
    """
    columns = probabilities.shape[1]
    half, stride = WINDOW // 2, columns + WINDOW - 1
    flat = probabilities.reshape(-1, 16)
    across, along, up = padded[0].reshape(-1), padded[1].reshape(-1), padded[2].reshape(-1)
    result = np.zeros((len(cell), 16), dtype=np.float32)
    said = np.zeros(len(cell), dtype=np.bool_)
    block, far = 512, np.int32(0x7FFFFFFF)
    corner = np.empty(block, dtype=np.int64)
    x, y, z = np.empty((3, block), dtype=np.float32)
    bits = np.empty(block, dtype=np.int32)
    gaps = bits.view(np.float32)
    kept = np.empty(1, dtype=np.int32)
    kept_gap = kept.view(np.float32)
    l0, l1, l2, l3, l4 = np.empty((5, block), dtype=np.int32)
    cutoff = np.float32(CUTOFF_M**2)
    for start in range(0, len(cell), block):
        count = min(block, len(cell) - start)
        for j in range(count):
            c = max(cell[start + j], np.int32(0))
            corner[j] = c // columns * stride + c % columns
            x[j], y[j], z[j] = points[start + j, 0], points[start + j, 1], points[start + j, 2]
        l0[:], l1[:], l2[:], l3[:], l4[:] = far, far, far, far, far
        for number in range(WINDOW * WINDOW):
            offset = number // WINDOW * stride + number % WINDOW
            for j in range(count):
                at = np.uint64(corner[j] + offset)
                dx, dy, dz = across[at] - x[j], along[at] - y[j], up[at] - z[j]
                gaps[j] = dx * dx + dy * dy + dz * dz
            for j in range(count):
                key = (bits[j] & ~np.int32(31)) | np.int32(number)
                key = key if gaps[j] <= cutoff else far
                low = l0[j]
                l0[j], key = min(low, key), max(low, key)
                low = l1[j]
                l1[j], key = min(low, key), max(low, key)
                low = l2[j]
                l2[j], key = min(low, key), max(low, key)
                low = l3[j]
                l3[j], key = min(low, key), max(low, key)
                l4[j] = min(l4[j], key)
        for j in range(count):
            i = start + j
            c = cell[i]
            if c < 0 or not distance[i] > 0.0:
                continue
            if l0[j] == far:  # nobody is near: its own cell, whose point is another surface's
                own = half * WINDOW + half
                if across[np.uint64(corner[j] + half * stride + half)] == np.float32(NOWHERE_M):
                    continue
                l0[j] = np.int32(own)
            said[i] = True
            total = np.float32(0.0)
            for key in (l0[j], l1[j], l2[j], l3[j], l4[j]):
                if key == far:
                    break
                number = key & np.int32(31)
                kept[0] = key & ~np.int32(31)
                gap_m = np.sqrt(kept_gap[0]) + np.float32(SOFTENING) * distance[i]
                weight = np.float32(1.0) / gap_m
                total += weight
                v, u = c // columns + number // WINDOW - half, c % columns + number % WINDOW - half
                u = u + columns if u < 0 else u
                u = u - columns if u >= columns else u
                source = np.uint64(v * columns + u)
                for k in range(16):
                    result[i, k] += weight * flat[source, k]
            share = np.float32(1.0) / total
            for k in range(16):
                result[i, k] *= share
    return result, said
