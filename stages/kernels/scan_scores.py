"""A network's answer on a range image back to the points of the scan."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled
from stages.kernels.probability import LEAST

#: The clean-up looks at 5 x 5 cells around a point's own and takes the five nearest in range; what
#: lies further than the cutoff says nothing of the point.
WINDOW = 5
CUTOFF_M = 1.0


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
    classes: int,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Each point gets the mean of what the network says of the cells nearest to it (kNN).

    Where several points share a cell, or a cell lies across an edge, its class bleeds onto the
    points behind. So of the 5 x 5 cells around a point's own, by |range - own range| * (1 - g) with
    g a normalized Gaussian of 1 cell, the five nearest within `CUTOFF_M` count; the point's own
    cell counts with the point's own range. SalsaNext lets their labels vote; here their
    probabilities are averaged, as Bayes' rule wants them. Columns go around. A point whose own cell
    has no return (of several points one stands for the cell) is told by the others alone.

    `probabilities` (rows, columns, 16); the rest and the result as `rows_by_cell`, as
    log-probabilities held above log 1e-6.
    """
    half = WINDOW // 2
    padded = np.full((nearest.shape[0] + 2 * half, nearest.shape[1]), -np.inf, dtype=np.float32)
    filled = padded[half:-half]
    filled[nearest >= 0] = distance[nearest[nearest >= 0]]
    filled[filled == 0.0] = -np.inf
    padded = np.concatenate([padded[:, -half:], padded, padded[:, :half]], axis=1)
    mean, said = _mean_of_neighbors(probabilities, padded, cell, distance, _penalties())
    np.maximum(mean, np.float32(LEAST), out=mean)
    if len(mean):
        cv2.log(mean, dst=mean)  # a tenth of the time of np.log
    mean[~said] = 0.0
    mean[:, classes:] = np.float32(-1e4)
    return mean, said


def _penalties() -> NDArray[np.float32]:
    """(5, 5) 1 - g, with g a Gaussian of sigma 1 cell whose sum is 1."""
    offset = np.arange(WINDOW) - WINDOW // 2
    g = np.exp(-0.5 * (offset[:, None] ** 2 + offset[None, :] ** 2))
    return np.asarray(1.0 - g / g.sum(), dtype=np.float32)


@compiled
def _mean_of_neighbors(
    probabilities: NDArray[np.float32],
    padded: NDArray[np.float32],
    cell: NDArray[np.int32],
    distance: NDArray[np.float32],
    penalties: NDArray[np.float32],
) -> Any:
    """Points in blocks, so that the search for the five least goes over many points at once.

    `padded` are the ranges with a border of 2 cells, -inf where there is no return. A gap and the
    number of its offset share one integer (the 5 low bits of the mantissa: gaps that differ by less
    than 4e-6 of themselves tie), so that keeping the least five sorted is a chain of minima and
    maxima without a branch.
    """
    columns = probabilities.shape[1]
    half, stride = WINDOW // 2, columns + WINDOW - 1
    flat, measured = probabilities.reshape(-1, 16), padded.reshape(-1)
    result = np.zeros((len(cell), 16), dtype=np.float32)
    said = np.zeros(len(cell), dtype=np.bool_)
    block, far = 512, np.int32(0x7FFFFFFF)
    corner = np.empty(block, dtype=np.int64)
    bits = np.empty(block, dtype=np.int32)
    gaps = bits.view(np.float32)
    l0, l1, l2, l3, l4 = np.empty((5, block), dtype=np.int32)
    cutoff = np.float32(CUTOFF_M)
    for start in range(0, len(cell), block):
        count = min(block, len(cell) - start)
        for j in range(count):
            c = max(cell[start + j], np.int32(0))
            corner[j] = c // columns * stride + c % columns
        l0[:], l1[:], l2[:], l3[:], l4[:] = far, far, far, far, far
        for number in range(WINDOW * WINDOW):
            dv, du = number // WINDOW, number % WINDOW
            penalty = penalties[dv, du]
            if dv == half and du == half:
                for j in range(count):  # the point itself, unless another stands for its cell
                    r = measured[np.uint64(corner[j] + half * stride + half)]
                    gaps[j] = np.float32(0.0) if r > 0.0 else np.float32(np.inf)
            else:
                for j in range(count):
                    r = measured[np.uint64(corner[j] + dv * stride + du)]
                    gaps[j] = abs(r - distance[start + j]) * penalty
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
            if c < 0 or not distance[i] > 0.0 or l0[j] == far:
                continue
            said[i] = True
            found = 0
            for key in (l0[j], l1[j], l2[j], l3[j], l4[j]):
                if key == far:
                    break
                found += 1
                number = key & np.int32(31)
                v, u = c // columns + number // WINDOW - half, c % columns + number % WINDOW - half
                u = u + columns if u < 0 else u
                u = u - columns if u >= columns else u
                source = np.uint64(v * columns + u)
                for k in range(16):
                    result[i, k] += flat[source, k]
            share = np.float32(1.0) / np.float32(found)
            for k in range(16):
                result[i, k] *= share
    return result, said
