"""Class probabilities of every pixel: soft-max, blend with the past (eq 6), likeliest class.

Images of probabilities are (height, classes, width) float32: planar within a row, so that loops
over pixels vectorize, and one row of all classes (51 kB) is finished in the core's cache before the
next begins. Main memory sees each probability twice, the past read and the present written, as one
stream each (as 15 planes of the whole image the same loops took 1.5 times as long).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled

#: No probability of a fused image exceeds 1 - CAP: eq 6 and 7 feed back, and a class that has
#: reached 1 could not be argued with. Each distribution is mixed with a little of the uniform one,
#: which holds the cap, keeps the sum and the order, and leaves no hard zero.
CAP = np.float32(1e-4)

#: Least probability of a class relative to the likeliest, as in `probability.LEAST`.
LOG_LEAST = np.float32(np.log(1e-6))

#: Scores beyond are held here, where differences and weighted sums stay finite.
HUGE = np.float32(1e30)


@compiled
def fuse_rows(
    grid: NDArray[Any],
    rects: NDArray[np.float32],
    scale: float,
    zero_point: float,
    align_corners: bool,
    share: NDArray[np.float32],
    past: NDArray[np.float32],
    source: NDArray[np.int32],
    fused: NDArray[np.float32],
    mask: NDArray[np.uint8],
    confidence: NDArray[np.float32],
) -> Any:
    """Fuse the log scores of an image with what was fused of the image before (eq 6).

    `grid` (tiles, rows, columns, channels) float32, int8 or uint8 in any strides, `rects` (tiles,
    4), `scale`, `zero_point` and `align_corners` are those of `sampling.sample_scores`, and so is
    the bilinear interpolation. p = soft-max of the log scores; with `share` (classes,) the weight
    alpha of the present and F = `past` (height, classes, width) at the pixel `source` (height,
    width) int32, row * width + column or -1 for none:

        S = normalize(alpha p + (1 - alpha) F), or p where there is no source

    Writes S, capped (`CAP`), to `fused` (height, classes, width), its likeliest class (ties to the
    lowest) to `mask` (height, width) and that probability to `confidence`. A grid cell with a NaN
    or +inf says nothing (all its scores 0), a pixel outside all tiles is uniform. An empty `source`
    (0, 0) is "no past at all". Returns the number of spoiled cells and of pixels outside all tiles.
    """
    height, classes, width = fused.shape
    tiles, rows, columns = grid.shape[0], grid.shape[1], grid.shape[2]
    first_c = np.zeros((tiles, width), dtype=np.uint32)
    part_c = np.zeros((tiles, width), dtype=np.float32)
    tent_c = np.zeros((tiles, width), dtype=np.float32)
    first_r = np.zeros((tiles, height), dtype=np.uint32)
    part_r = np.zeros((tiles, height), dtype=np.float32)
    tent_r = np.zeros((tiles, height), dtype=np.float32)
    if rows == 0 or columns == 0:
        tiles = 0
    for t in range(tiles):
        x0, y0, x1, y1 = rects[t, 0], rects[t, 1], rects[t, 2], rects[t, 3]
        _along_axis(x0, x1, columns, align_corners, first_c[t], part_c[t], tent_c[t])
        _along_axis(y0, y1, rows, align_corners, first_r[t], part_r[t], tent_r[t])

    # Per tile the two grid rows around the image row, spread over the image's columns: most image
    # rows find both from the row before.
    spread = np.zeros((tiles, 2, classes, width), dtype=np.float32)
    held = np.full((tiles, 2), -1, dtype=np.int64)
    cells = np.zeros((classes, columns), dtype=np.float32)
    p = np.zeros((classes, width), dtype=np.float32)
    weight = np.zeros(width, dtype=np.float32)
    spoiled, uncovered = 0, 0
    for y in range(height):
        p[:] = 0.0
        weight[:] = 0.0
        for t in range(tiles):
            if not tent_r[t, y] >= 0.0:
                continue
            above = int(first_r[t, y])
            below = min(above + 1, rows - 1)
            for row in range(above, below + 1):
                if held[t, row & 1] != row:
                    held[t, row & 1] = row
                    spoiled += _load_cells(grid[t, row], scale, zero_point, cells)
                    _spread(cells, first_c[t], part_c[t], spread[t, row & 1])
            upper, lower = spread[t, above & 1], spread[t, below & 1]
            if tiles == 1:
                _add_only_tile(upper, lower, part_r[t, y], tent_c[t], p, weight)
            else:
                _add_tile(upper, lower, part_r[t, y], tent_r[t, y], tent_c[t], p, weight)
        for x in range(width):
            uncovered += weight[x] == 0.0
        if tiles > 1:
            for x in range(width):
                weight[x] = 1.0 / weight[x] if weight[x] > 0.0 else 0.0
            for k in range(classes):
                for x in range(width):
                    p[k, x] *= weight[x]
        total = _soft_max(p)
        if source.size > 0:
            total = _blend(p, total, share, past.reshape(-1), source[y])
        _finish(p, total, fused[y], mask[y], confidence[y])
    return spoiled, uncovered


@compiled
def _along_axis(
    low: float,
    high: float,
    cells: int,
    align_corners: bool,
    first: NDArray[np.uint32],
    part: NDArray[np.float32],
    tent: NDArray[np.float32],
) -> None:
    """Per pixel of an axis: the cell before it, how far on to the next, and the tent weight, which
    is negative where the tile (pixel edges `low` to `high`) does not reach."""
    for i in range(len(first)):
        at = i + 0.5
        tent[i] = -1.0
        if not (at >= low and at <= high and high > low and np.isfinite(high - low)):
            continue
        if align_corners:
            cell = (at - low - 0.5) / max(high - low - 1.0, 1.0) * (cells - 1)
        else:
            cell = (at - low) / (high - low) * cells - 0.5
        cell = min(max(cell, 0.0), cells - 1.0)
        first[i] = min(int(cell), max(cells - 2, 0))
        part[i] = cell - first[i]
        tent[i] = min(at - low, high - at) / (high - low)


@compiled
def _load_cells(
    grid: NDArray[Any], scale: float, zero_point: float, cells: NDArray[np.float32]
) -> Any:
    """One grid row (columns, channels) as log scores `cells` (classes, columns), finite; returns
    how many columns were spoiled."""
    classes, columns = cells.shape
    gain, zero = np.float32(scale), np.float32(zero_point)
    sound = np.ones(columns, dtype=np.bool_)
    for k in range(classes):
        for c in range(columns):
            value = (np.float32(grid[c, k]) - zero) * gain
            sound[c] &= value <= HUGE
            cells[k, c] = max(value, -HUGE)
    spoiled = 0
    for c in range(columns):
        if not sound[c]:
            spoiled += 1
            for k in range(classes):
                cells[k, c] = 0.0
    return spoiled


@compiled
def _spread(
    cells: NDArray[np.float32],
    first: NDArray[np.uint32],
    part: NDArray[np.float32],
    line: NDArray[np.float32],
) -> None:
    """Interpolate a row of cells (classes, columns) to the image's columns (classes, width)."""
    second = np.minimum(first + np.uint32(1), np.uint32(cells.shape[1] - 1)).astype(np.uint32)
    for k in range(line.shape[0]):
        row = cells[k]
        for x in range(line.shape[1]):
            a = row[first[x]]
            line[k, x] = a + part[x] * (row[second[x]] - a)


@compiled
def _add_only_tile(
    upper: NDArray[np.float32],
    lower: NDArray[np.float32],
    part: float,
    tent: NDArray[np.float32],
    p: NDArray[np.float32],
    weight: NDArray[np.float32],
) -> None:
    """The interpolated scores of the only tile: no weights to divide out."""
    down = np.float32(part)
    for x in range(p.shape[1]):
        weight[x] = np.float32(1.0) if tent[x] >= 0.0 else np.float32(0.0)
    for k in range(p.shape[0]):
        for x in range(p.shape[1]):
            p[k, x] = (upper[k, x] + down * (lower[k, x] - upper[k, x])) * weight[x]


@compiled
def _add_tile(
    upper: NDArray[np.float32],
    lower: NDArray[np.float32],
    part: float,
    tent_y: float,
    tent: NDArray[np.float32],
    p: NDArray[np.float32],
    weight: NDArray[np.float32],
) -> None:
    """Add a tile's interpolated scores times its tent weight, as `sample_scores` does."""
    down = np.float32(part)
    left, right = 0, p.shape[1]
    while left < right and tent[left] < 0.0:
        left += 1
    while right > left and tent[right - 1] < 0.0:
        right -= 1
    gain = (np.float32(tent_y) * tent[left:right] + np.float32(1e-6)).astype(np.float32)
    weight[left:right] += gain
    for k in range(p.shape[0]):
        above, below, into = upper[k, left:right], lower[k, left:right], p[k, left:right]
        for x in range(right - left):
            into[x] += gain[x] * (above[x] + down * (below[x] - above[x]))


@compiled
def _soft_max(p: NDArray[np.float32]) -> Any:
    """Exponentials of scores (classes, width) below their maximum, in place; returns their sums.

    exp(v) = 2^n exp(r), |r| <= ln 2 / 2, by the minimax polynomial of degree 5 (relative error
    8e-8): unlike the library's it becomes vector instructions.
    """
    classes, width = p.shape
    top = p[0].copy()
    total = np.zeros(width, dtype=np.float32)
    for k in range(1, classes):
        for x in range(width):
            top[x] = max(top[x], p[k, x])
    for k in range(classes):
        for x in range(width):
            v = max(p[k, x] - top[x], LOG_LEAST)
            n = np.floor(v * np.float32(1.4426950408889634) + np.float32(0.5))
            r = v - n * np.float32(0.693359375) + n * np.float32(2.12194440e-4)
            e = np.float32(8.297619175e-3) * r + np.float32(4.191562923e-2)
            e = e * r + np.float32(1.666757655e-1)
            e = e * r + np.float32(4.999889266e-1)
            e = e * r + np.float32(9.999996911e-1)
            e = e * r + np.float32(1.000000072)
            power = np.int32((np.int32(n) + np.int32(127)) << np.int32(23)).view(np.float32)
            p[k, x] = e * power
            total[x] += p[k, x]
    return total


@compiled
def _blend(
    p: NDArray[np.float32],
    total: NDArray[np.float32],
    share: NDArray[np.float32],
    past: NDArray[np.float32],
    source: NDArray[np.int32],
) -> Any:
    """Eq 6 up to its normalization, in place; returns the new sums."""
    classes, width = p.shape
    across, lines = np.uint32(width), np.uint32(classes * width)
    gain = np.empty(width, dtype=np.float32)  # normalizes the present
    keep = np.empty(width, dtype=np.float32)  # 1 where there is a past
    place = np.empty(width, dtype=np.uint32)  # unsigned: no test for a count from the end
    for x in range(width):
        gain[x] = np.float32(1.0) / total[x]
        keep[x] = np.float32(1.0) if source[x] >= 0 else np.float32(0.0)
        pixel = np.uint32(max(source[x], np.int32(0)))
        place[x] = pixel // across * lines + pixel % across
    # A gather does not set off the hardware's prefetching, a plain read does: reading the rows that
    # the next image row will need ahead of it takes 1 ms of 14 off a frame.
    rows = np.uint32(len(past)) // lines
    soon = min(place[width // 2] // lines + np.uint32(2), rows - np.uint32(1)) * lines
    before = np.empty(width, dtype=np.float32)
    blended = np.zeros(width, dtype=np.float32)
    for k in range(classes):
        plane, ahead = past[k * width :], past[soon + np.uint32(k * width) :]
        for x in range(width):
            before[x] = ahead[x]
        for x in range(width):
            before[x] = plane[place[x]]  # apart from the arithmetic, which stays plain vectors
        stays = np.float32(1.0) - share[k]
        for x in range(width):
            old = stays * keep[x]
            p[k, x] = (np.float32(1.0) - old) * gain[x] * p[k, x] + old * before[x]
            blended[x] += p[k, x]
    return blended


@compiled
def _finish(
    p: NDArray[np.float32],
    total: NDArray[np.float32],
    fused: NDArray[np.float32],
    mask: NDArray[np.uint8],
    confidence: NDArray[np.float32],
) -> None:
    """Normalize, cap and store one row, and find its likeliest classes."""
    classes, width = p.shape
    even = CAP / np.float32(max(classes - 1, 1))
    kept = np.float32(1.0) - even * np.float32(classes)
    label = np.zeros(width, dtype=np.int32)
    best = np.zeros(width, dtype=np.float32)
    gain = np.empty(width, dtype=np.float32)
    for x in range(width):
        gain[x] = kept / total[x]
    for k in range(classes):
        for x in range(width):
            value = p[k, x] * gain[x] + even
            fused[k, x] = value
            label[x] = np.int32(k) if value > best[x] else label[x]
            best[x] = max(best[x], value)
    for x in range(width):
        mask[x] = label[x]
        confidence[x] = best[x]


@compiled
def colorize(mask: NDArray[np.uint8], colors: NDArray[np.uint8]) -> Any:
    """The mask (height, width) in the colors (classes, 3) of its classes, RGB."""
    height, width = mask.shape
    picture = np.empty((height, width, 3), dtype=np.uint8)
    for y in range(height):
        for x in range(width):
            label = mask[y, x]
            for channel in range(3):
                picture[y, x, channel] = colors[label, channel]
    return picture
