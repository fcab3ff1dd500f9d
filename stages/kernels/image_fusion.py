"""Class probabilities of every pixel: soft-max, blend with the past (eq 6), likeliest class.

Images of probabilities are (height, classes, width) float32: planar within a row, so that loops
over pixels vectorize. A row is finished block by block, all classes of a block in the core's first
cache. Main memory sees each probability twice, the past read and the present written (as 15 planes
of the whole image the same loops took 1.5 times as long); both are asked for while the block's
exponentials are computed, which takes 2 of 12 ms off an image of 848 x 480.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import (
    LINE,
    compiled,
    compiled_contracted,
    prefetch,
    prefetch_to_write,
)

#: No probability of a fused image exceeds 1 - CAP: eq 6 and 7 feed back, and a class that has
#: reached 1 could not be argued with. Each distribution is mixed with a little of the uniform one,
#: which holds the cap, keeps the sum and the order, and leaves no hard zero.
CAP = np.float32(1e-4)

#: Least probability of a class relative to the likeliest, as in `probability.LEAST`.
LOG_LEAST = np.float32(np.log(1e-6))

#: Scores beyond are held here, where differences and weighted sums stay finite.
HUGE = np.float32(1e30)

#: Pixels of a row that are finished together: 15 classes, then and now, take 23 kB.
BLOCK = 128

LOG2_E = np.float32(1.4426950408889634)

#: 1.5 * 2^23: added to a small number, it leaves the nearest whole number in the lowest bits.
ROUNDING = np.float32(12582912.0)


@compiled
def fuse_rows(
    grid: NDArray[Any],
    rects: NDArray[np.float32],
    scale: float,
    zero_point: float,
    share: NDArray[np.float32],
    past: NDArray[np.float32],
    source: NDArray[np.int32],
    fused: NDArray[np.float32],
    mask: NDArray[np.uint8],
    confidence: NDArray[np.float32],
) -> Any:
    """Fuse the log scores of an image with what was fused of the image before (eq 6).

    `grid` (tiles, rows, columns, channels) float32, int8 or uint8 in any strides, `rects` (tiles,
    4), `scale` and `zero_point` are those of `sampling.sample_scores`, and so is the bilinear
    interpolation. p = soft-max of the log scores; with `share` (classes,) the weight
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
    as_pixels = np.full(tiles, columns == width)  # a column of cells is a column of pixels
    if rows == 0 or columns == 0:
        tiles = 0
    for t in range(tiles):
        x0, y0, x1, y1 = rects[t, 0], rects[t, 1], rects[t, 2], rects[t, 3]
        _along_axis(x0, x1, columns, first_c[t], part_c[t], tent_c[t])
        _along_axis(y0, y1, rows, first_r[t], part_r[t], tent_r[t])
        for x in range(width):
            as_pixels[t] &= np.float32(first_c[t, x] + part_c[t, x]) == x

    # Per tile the two grid rows around the image row, spread over the image's columns: most image
    # rows find both from the row before.
    spread = np.zeros((max(tiles, 1), 2, classes, width), dtype=np.float32)
    held = np.full((tiles, 2), -1, dtype=np.int64)
    cells = np.zeros((classes, columns), dtype=np.float32)
    p = np.zeros((classes, width), dtype=np.float32)
    weight = np.zeros(width, dtype=np.float32)
    place = np.zeros(width, dtype=np.uint32)
    kept = np.zeros(width, dtype=np.float32)
    top, total = np.zeros(BLOCK, dtype=np.float32), np.zeros(BLOCK, dtype=np.float32)
    before, blended = np.zeros(BLOCK, dtype=np.float32), np.zeros(BLOCK, dtype=np.float32)
    label, ago = np.zeros(BLOCK, dtype=np.int32), past.reshape(-1)
    spoiled, uncovered = 0, 0
    for y in range(height):
        only = tiles == 1 and tent_r[0, y] >= 0.0  # then its scores are added block by block
        upper, lower, part = spread[0, 0], spread[0, 1], np.float32(0.0)
        weight[:] = 0.0
        if not only:
            p[:] = 0.0
        for t in range(tiles):
            if not tent_r[t, y] >= 0.0:
                continue
            above = int(first_r[t, y])
            below = min(above + 1, rows - 1)
            for row in range(above, below + 1):
                if held[t, row & 1] != row:
                    held[t, row & 1] = row
                    line = spread[t, row & 1]
                    if as_pixels[t]:
                        spoiled += _load_cells(grid[t, row], scale, zero_point, line)
                    else:
                        spoiled += _load_cells(grid[t, row], scale, zero_point, cells)
                        _spread(cells, first_c[t], part_c[t], line)
            upper, lower, part = spread[t, above & 1], spread[t, below & 1], part_r[t, y]
            if only:
                _cover(tent_c[t], weight)
            else:
                _add_tile(upper, lower, part, tent_r[t, y], tent_c[t], p, weight)
        for x in range(width):
            uncovered += weight[x] == 0.0
        if tiles > 1:
            for x in range(width):
                weight[x] = 1.0 / weight[x] if weight[x] > 0.0 else 0.0
            for k in range(classes):
                for x in range(width):
                    p[k, x] *= weight[x]
        if source.size > 0:
            _find_places(source[y], classes, place, kept)
        for first in range(0, width, BLOCK):
            last = min(first + BLOCK, width)
            if only:
                _add_only_tile(upper, lower, part, first, last, p, weight)
            continues = bool(kept[first:last].any())
            _exponentials(p, first, last, fused[y], ago, place, continues, top, total)
            if continues:
                _blend(p, first, last, share, ago, place, kept, before, blended, total)
            _finish(p, first, last, total, fused[y], mask[y], confidence[y], top, label)
    return spoiled, uncovered


@compiled
def _along_axis(
    low: float,
    high: float,
    cells: int,
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


@compiled_contracted
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
def _cover(tent: NDArray[np.float32], weight: NDArray[np.float32]) -> None:
    """1 where the only tile reaches: no weights to divide out."""
    for x in range(len(weight)):
        weight[x] = np.float32(1.0) if tent[x] >= 0.0 else np.float32(0.0)


@compiled_contracted
def _add_only_tile(
    upper: NDArray[np.float32],
    lower: NDArray[np.float32],
    part: np.float32,
    first: int,
    last: int,
    p: NDArray[np.float32],
    weight: NDArray[np.float32],
) -> None:
    """The interpolated scores of the only tile in one block of a row."""
    down = np.float32(part)
    covered = weight[first:last]
    for k in range(p.shape[0]):
        above, below, into = upper[k, first:last], lower[k, first:last], p[k, first:last]
        for x in range(last - first):
            into[x] = (above[x] + down * (below[x] - above[x])) * covered[x]


@compiled_contracted
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
def _find_places(
    source: NDArray[np.int32],
    classes: int,
    place: NDArray[np.uint32],
    kept: NDArray[np.float32],
) -> None:
    """Where the first class of a row's sources lies in the past, and 1 where there is a source."""
    width = len(source)
    per_row = 1.0 / width
    for x in range(width):
        pixel = max(source[x], np.int32(0))
        row = np.int32((pixel + 0.5) * per_row)  # exact, and becomes vectors as // does not
        place[x] = row * (classes * width) + (pixel - row * width)
        kept[x] = np.float32(1.0) if source[x] >= 0 else np.float32(0.0)


@compiled_contracted
def _exponentials(
    p: NDArray[np.float32],
    first: int,
    last: int,
    fused: NDArray[np.float32],
    past: NDArray[np.float32],
    place: NDArray[np.uint32],
    continues: bool,
    top: NDArray[np.float32],
    total: NDArray[np.float32],
) -> None:
    """Exponentials of scores (classes, width) below their maximum, in place, and their sums.

    exp(v) = 2^n 2^f, n the nearest whole number to v log2 e and |f| <= 1/2, by the minimax
    polynomial of degree 5 (relative error 3e-7 in float32): unlike the library's it becomes vector
    instructions. Meanwhile memory brings what the block needs next.
    """
    classes, width = p.shape
    n = last - first
    for x in range(n):
        top[x] = p[0, first + x]
    # From one array into another and back: a maximum in place becomes a masked store, which some
    # processors (Zen) take ten times as long for.
    highest, higher = top, total
    for k in range(1, classes):
        row = p[k, first:last]
        for x in range(n):
            higher[x] = max(highest[x], row[x])
        highest, higher = higher, highest
    if classes % 2 == 0:
        for x in range(n):
            top[x] = highest[x]
    for x in range(n):
        total[x] = 0.0
    for k in range(classes):
        for x in range(first, last, LINE):
            prefetch_to_write(fused, k * width + x)
            if continues:
                prefetch(past, place[x] + k * width)
        row = p[k, first:last]
        for x in range(n):
            v = max(row[x] - top[x], LOG_LEAST) * LOG2_E
            rounded = np.float32(v + ROUNDING)
            f = v - (rounded - ROUNDING)
            e = np.float32(1.3276472e-3) * f + np.float32(9.675541e-3)
            e = e * f + np.float32(5.550713e-2)
            e = e * f + np.float32(2.402212e-1)
            e = e * f + np.float32(6.9314694e-1)
            e = np.float32(e * f + np.float32(1.0000001))
            n_bits = np.int32(rounded.view(np.int32) << np.int32(23))
            e = np.int32(e.view(np.int32) + n_bits).view(np.float32)
            row[x] = e
            total[x] += e


@compiled_contracted
def _blend(
    p: NDArray[np.float32],
    first: int,
    last: int,
    share: NDArray[np.float32],
    past: NDArray[np.float32],
    place: NDArray[np.uint32],
    kept: NDArray[np.float32],
    before: NDArray[np.float32],
    blended: NDArray[np.float32],
    total: NDArray[np.float32],
) -> None:
    """Eq 6 of exponentials with sums `total`, up to its normalization, in place; `total` becomes
    the new sums."""
    classes, width = p.shape
    n = last - first
    at, keeps = place[first:last], kept[first:last]
    for x in range(n):
        blended[x] = 0.0
    for k in range(classes):
        plane, row = past[k * width :], p[k, first:last]
        for x in range(n):
            before[x] = plane[at[x]]  # apart from the arithmetic, which stays plain vectors
        stays = np.float32(1.0) - share[k]
        for x in range(n):
            old = stays * keeps[x]
            value = (np.float32(1.0) - old) * row[x] + old * total[x] * before[x]
            row[x] = value
            blended[x] += value
    for x in range(n):
        total[x] = blended[x]


@compiled_contracted
def _finish(
    p: NDArray[np.float32],
    first: int,
    last: int,
    total: NDArray[np.float32],
    fused: NDArray[np.float32],
    mask: NDArray[np.uint8],
    confidence: NDArray[np.float32],
    best: NDArray[np.float32],
    label: NDArray[np.int32],
) -> None:
    """Normalize, cap and store one block, and find its likeliest classes."""
    classes = p.shape[0]
    n = last - first
    even = CAP / np.float32(max(classes - 1, 1))
    certain = np.float32(1.0) - even * np.float32(classes)
    for x in range(n):
        total[x] = certain / total[x]
        best[x] = 0.0
        label[x] = 0
    for k in range(classes):
        row, into = p[k, first:last], fused[k, first:last]
        for x in range(n):
            value = row[x] * total[x] + even
            into[x] = value
            label[x] = np.int32(k) if value > best[x] else label[x]
            best[x] = max(best[x], value)
    labels, sure = mask[first:last], confidence[first:last]
    for x in range(n):
        labels[x] = label[x]
        sure[x] = best[x]


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
