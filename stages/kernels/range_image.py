"""LiDAR scans as range images (eq 18), and a network's answer back to the points.

A range image has `rows` x `columns` cells, row 0 highest and column 0 straight behind, going
clockwise; cell number = row * columns + column. Channels, in this order: range, x, y, z and (five
channels) remission, each as (value - mean) / std, and 0 where the cell has no return.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import as_input, compiled
from stages.kernels.probability import LEAST

#: The clean-up after the network looks at 5 x 5 cells around a point's own and takes the five
#: nearest in range; what lies further than the cutoff says nothing of the point.
WINDOW = 5
CUTOFF_M = 1.0


@compiled
def _angle(y: Any, x: Any) -> Any:
    """atan2 of float32, off by at most 6e-7 rad; NaN where both are 0 or infinite.

    The odd polynomial is a fit of atan on [0, 1] (error 2.5e-7). It has no call and no branch, so
    that its callers vectorize.
    """
    a, b = abs(x), abs(y)
    low = a if a < b else b
    high = b if a < b else a
    t = low / high
    q = t * t
    p = np.float32(0.00681179265824283)
    p = p * q - np.float32(0.03360421889048546)
    p = p * q + np.float32(0.07962367087437056)
    p = p * q - np.float32(0.1323334205361447)
    p = p * q + np.float32(0.19807815572245105)
    p = p * q - np.float32(0.33317368059500096)
    p = (p * q + np.float32(0.9999961115539868)) * t
    p = np.float32(np.pi / 2) - p if b > a else p
    p = np.float32(np.pi) - p if x < np.float32(0.0) else p
    return -p if y < np.float32(0.0) else p


def project_scan(
    points: NDArray[np.float32],
    size: tuple[int, int],
    elevation_rad: tuple[float, float],
    max_range_m: float = np.inf,
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]:
    """Eq 18: the cell of each point, and the nearest point of each cell.

    `points` (n, 3) m in the sensor's frame, `size` (rows, columns), `elevation_rad` the lowest and
    the highest. With r = |p|: column = floor((1 - atan2(y, x) / pi) / 2 * columns), row =
    floor((highest - asin(z / r)) / (highest - lowest) * rows). Points out of the field of view,
    beyond the range limit, at the origin or not finite are in no cell: in the border rows, where a
    clamp would put them, they would hide the points that belong there. Of equal ranges the first
    point is kept.

    Returns the point of each cell (rows, columns) int32, -1 where none; the cell of each point (n,)
    int32, -1 where none; and its range (n,) float32 m, 0 where it has no return.
    """
    # Planes, not rows of three: the loop over them vectorizes (0.3 instead of 1.8 ms per 131,072).
    x, y, z = as_input(points.T)
    cell, distance = _cells(x, y, z, *size, *elevation_rad, max_range_m)
    return _nearest(cell, distance, size[0] * size[1]).reshape(size), cell, distance


@compiled
def _cells(
    xs: NDArray[np.float32],
    ys: NDArray[np.float32],
    zs: NDArray[np.float32],
    rows: int,
    columns: int,
    lowest_rad: float,
    highest_rad: float,
    max_range_m: float,
) -> Any:
    n = len(xs)
    cell = np.empty(n, dtype=np.int32)
    distance = np.empty(n, dtype=np.float32)
    per_column = np.float32(0.5 * columns / np.pi)
    per_row = np.float32(rows / (highest_rad - lowest_rad))
    highest, limit = np.float32(highest_rad), np.float32(max_range_m)
    height, width = np.float32(rows), np.int32(columns)
    last_row, last_column = np.int32(rows - 1), np.int32(columns - 1)
    infinite, none = np.float32(np.inf), np.float32(0.0)
    for i in range(n):
        x, y, z = xs[i], ys[i], zs[i]
        flat = x * x + y * y
        square = flat + z * z
        real = (square > none) & (square < infinite)
        r = np.sqrt(square)
        distance[i] = r if real else none
        row = (highest - _angle(z, np.sqrt(flat))) * per_row
        column = (np.float32(np.pi) - _angle(y, x)) * per_column
        inside = real & (r <= limit) & (row >= none) & (row <= height) & (column >= none)
        v, u = np.int32(row if inside else none), np.int32(column if inside else none)
        v = v if v < last_row else last_row
        u = u if u < last_column else last_column
        cell[i] = v * width + u if inside else np.int32(-1)
    return cell, distance


@compiled
def _nearest(cell: NDArray[np.int32], distance: NDArray[np.float32], cells: int) -> Any:
    """The z-buffer: bits of the range (ordered like the range) over the index, least wins."""
    bits = distance.view(np.int32)
    empty = np.int64(0x7FFFFFFFFFFFFFFF)
    least = np.full(cells + 1, empty, dtype=np.int64)  # place 0 takes the discarded
    for i in range(len(cell)):
        place = np.uint64(cell[i] + 1)
        key = (np.int64(bits[i]) << 32) | np.int64(i)
        least[place] = key if key < least[place] else least[place]
    nearest = np.empty(cells, dtype=np.int32)
    for c in range(cells):
        key = least[c + 1]
        nearest[c] = np.int32(key & 0x7FFFFFFF) if key < empty else np.int32(-1)
    return nearest


@compiled
def ranges(points: NDArray[np.float32]) -> Any:
    """Ranges (n,) float32 of points (n, 3) in m; 0 where there is no return or it is not finite."""
    result = np.empty(len(points), dtype=np.float32)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        square = x * x + y * y + z * z
        result[i] = np.sqrt(square) if square < np.float32(np.inf) else np.float32(0.0)
    return result


def organized_cells(
    shape: tuple[int, int], size: tuple[int, int]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The same for an organized scan, whose rows and columns are the cells: no projection.

    `shape` is the scan's (rows, columns), `size` the image's, of which it is a whole multiple.
    Returns the point of each cell (rows, columns) and the cell of each point (n,), both int32.
    Raises ValueError for other sizes.
    """
    if shape[0] % size[0] or shape[1] % size[1] or 0 in size:
        raise ValueError(
            f"a scan of {shape[0]} x {shape[1]} does not divide into {size[0]} x {size[1]} cells"
        )
    row_step, column_step = shape[0] // size[0], shape[1] // size[1]
    number = np.arange(shape[0] * shape[1], dtype=np.int32).reshape(shape)
    cell = np.arange(size[0] * size[1], dtype=np.int32).reshape(size)
    spread = cell.repeat(row_step, axis=0).repeat(column_step, axis=1)
    return np.ascontiguousarray(number[::row_step, ::column_step]), spread.reshape(-1)


@compiled
def fill_channels(
    points: NDArray[np.float32],
    remission: NDArray[np.float32],
    nearest: NDArray[np.int32],
    mean: NDArray[np.float32],
    std: NDArray[np.float32],
) -> Any:
    """The network's input and the ranges behind it.

    `points` (n, 3), `remission` (n,) 0..1 or (0,) where the sensor has none (its channel is then
    the mean, 0), `nearest` (rows, columns) as `project_scan` gives it, `mean` and `std` (4,) or
    (5,). Returns the channels (rows, columns, 4 or 5) float32 and the ranges (rows, columns)
    float32 in m; both 0 where there is no return.
    """
    cells, depth = nearest.size, len(mean)
    channels = np.empty((cells, depth), dtype=np.float32)
    ranges = np.empty(cells, dtype=np.float32)
    point_of = nearest.reshape(-1)
    gain = np.float32(1.0) / std
    none = np.float32(0.0)
    reflects = depth == 5 and len(remission) > 0
    for c in range(cells):
        i = np.uint64(max(point_of[c], np.int32(0)))
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        square = x * x + y * y + z * z
        real = (square > none) & (square < np.float32(np.inf)) & (point_of[c] >= 0)
        r = np.sqrt(square) if real else none
        ranges[c] = r
        channels[c, 0] = (r - mean[0]) * gain[0] if real else none
        channels[c, 1] = (x - mean[1]) * gain[1] if real else none
        channels[c, 2] = (y - mean[2]) * gain[2] if real else none
        channels[c, 3] = (z - mean[3]) * gain[3] if real else none
        if depth == 5:
            value = remission[i] if reflects else mean[4]
            real &= abs(value) < np.float32(np.inf)
            channels[c, 4] = (value - mean[4]) * gain[4] if real else none
    rows, columns = nearest.shape
    return channels.reshape(rows, columns, depth), ranges.reshape(rows, columns)


@compiled
def rows_by_cell(
    log_scores: NDArray[np.float32],
    ranges: NDArray[np.float32],
    cell: NDArray[np.int32],
    distance: NDArray[np.float32],
    classes: int,
) -> Any:
    """Each point gets what the network says of its cell.

    `log_scores` (rows, columns, 16), `ranges` (rows, columns) m, `cell` (n,) and `distance` (n,) m
    of the points. Returns (n, 16) float32 and (n,) bool: the point has a return and lies in a cell
    that has one; else its row is uniform (0).
    """
    scores, measured = log_scores.reshape(-1, 16), ranges.reshape(-1)
    result = np.zeros((len(cell), 16), dtype=np.float32)
    said = np.zeros(len(cell), dtype=np.bool_)
    for i in range(len(cell)):
        c = cell[i]
        if c >= 0 and distance[i] > 0.0 and measured[c] > 0.0:
            said[i] = True
            for k in range(16):
                result[i, k] = scores[c, k]
        for k in range(classes, 16):
            result[i, k] = np.float32(-1e4)
    return result, said


def rows_by_neighbors(
    probabilities: NDArray[np.float32],
    ranges: NDArray[np.float32],
    cell: NDArray[np.int32],
    distance: NDArray[np.float32],
    classes: int,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Each point gets the mean of what the network says of the cells nearest to it (kNN).

    Where several points share a cell, or a cell lies across an edge, its class bleeds onto the
    points behind. So of the 5 x 5 cells around a point's own, by |range - own range| * (1 - g) with
    g a normalized Gaussian of 1 cell, the five nearest within `CUTOFF_M` count; the point's own
    cell counts with the point's own range. SalsaNext lets their labels vote; here their
    probabilities are averaged, as Bayes' rule wants them. Columns go around.

    `probabilities` (rows, columns, 16); the rest and the result as `rows_by_cell`, as
    log-probabilities held above log 1e-6.
    """
    half = WINDOW // 2
    padded = np.full((ranges.shape[0] + 2 * half, ranges.shape[1]), -np.inf, dtype=np.float32)
    padded[half:-half] = np.where(ranges > 0, ranges, np.float32(-np.inf))
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
                gaps[:count] = np.float32(0.0)  # the point itself
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
            own = np.uint64(corner[j] + half * stride + half)
            if c < 0 or not distance[i] > 0.0 or not measured[own] > 0.0:
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


def as_remission(raw: NDArray[Any], full_scale: float) -> NDArray[np.float32]:
    """A sensor's signal, intensity or reflectivity (n,) in 0..1; what is not finite becomes 0.

    `full_scale` is the count that means 1: 255 for Ouster's 8-bit REFLECTIVITY, 1 for KITTI's
    intensity, for SIGNAL (photons, unbounded) what a white wall gives.
    """
    scaled = np.asarray(raw, dtype=np.float32) / np.float32(full_scale)
    finite = np.nan_to_num(scaled, nan=0.0, posinf=0.0, neginf=0.0)
    return np.asarray(np.clip(finite, 0.0, 1.0), dtype=np.float32)


def moments(channels: NDArray[np.float32], ranges: NDArray[np.float32]) -> NDArray[np.float64]:
    """(3, channels) number, sum and sum of squares over the cells with a return; they add up.

    `channels` as `fill_channels` gives them for mean 0 and std 1.
    """
    values = channels[ranges > 0].astype(np.float64)
    count = np.full(channels.shape[-1], len(values), dtype=np.float64)
    return np.stack([count, values.sum(axis=0), (values**2).sum(axis=0)])


def mean_and_std(
    total: NDArray[np.float64],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean and standard deviation (channels,) of added-up `moments`, of a sensor's own data.

    A channel that does not vary gets std 1, so that it becomes 0. No cell at all: mean 0, std 1.
    """
    count = np.maximum(total[0], 1.0)
    mean = total[1] / count
    std = np.sqrt(np.maximum(total[2] / count - mean**2, 0.0))
    return mean.astype(np.float32), np.where(std > 1e-6, std, 1.0).astype(np.float32)


def adapted(network: NDArray[np.float32], own: NDArray[np.float32]) -> NDArray[np.float32]:
    """The network's mean or std (4,) or (5,) with z and remission of a sensor's own data.

    Both sensors see all around, so range, x and y stay as the network knows them (the paper's
    adaptation); its height above ground and its remission differ.
    """
    result = network.copy()
    result[3:] = own[3 : len(network)]
    return result
