"""Class scores at pixels, taken from score grids at any stride, in one or more tiles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled, compiled_contracted, prefetch

#: So many points ahead the cells around one are asked for (of the first tile, where the grid is
#: contiguous): a scan's neighbors lie rows apart in an image, and full-size scores fill no cache.
AHEAD = 16


@compiled_contracted
def sample_scores(
    grid: NDArray[Any],
    rects: NDArray[np.float32],
    scale: float,
    zero_point: float,
    pixel: NDArray[np.float32],
    classes: int,
) -> Any:
    """Log scores at pixels u v (m, 2), bilinear in the grid, without dequantizing the grid.

    `grid` (tiles, rows, columns, channels) float32, int8 or uint8, in any strides; value = (grid -
    zero_point) * scale. `rects` (tiles, 4) x0 y0 x1 y1 are the pixel edges that each tile covers:
    pixel u lies at u + 0.5, and the cells divide the rectangle evenly; beyond the centers of the
    outer cells these hold. Where tiles overlap they are averaged with tent weights, greatest in a
    tile's center and 0 on its edge.

    Returns (m, 16) float32 with 0 in the channels from `classes` on, and (m,) bool: some tile
    covers the pixel (else the row is 0).
    """
    tiles, rows, columns, channels = grid.shape
    tiles = tiles if rows > 0 and columns > 0 else 0
    result = np.zeros((len(pixel), 16), dtype=np.float32)
    covered = np.zeros(len(pixel), dtype=np.bool_)
    across, down = np.empty((tiles, 2)), np.empty((tiles, 2))
    for tile in range(tiles):
        x0, y0, x1, y1 = rects[tile, 0], rects[tile, 1], rects[tile, 2], rects[tile, 3]
        across[tile, 0], across[tile, 1] = _cells_per_pixel(x0, x1, columns)
        down[tile, 0], down[tile, 1] = _cells_per_pixel(y0, y1, rows)
    one, shift = np.float32(1.0), np.float32(zero_point * scale)
    right, below = np.uint64(columns > 1), np.uint64(rows > 1)
    for i in range(len(pixel)):
        if tiles > 0 and i + AHEAD < len(pixel):
            soon_x, soon_y = pixel[i + AHEAD, 0] + 0.5, pixel[i + AHEAD, 1] + 0.5
            soon_c = int(min(max(soon_x * across[0, 0] + across[0, 1], 0.0), columns - 1.0))
            soon_r = int(min(max(soon_y * down[0, 0] + down[0, 1], 0.0), rows - 1.0))
            for corner in (0, 1, columns, columns + 1):
                prefetch(grid, (soon_r * columns + soon_c + corner) * channels)
        x, y = pixel[i, 0] + 0.5, pixel[i, 1] + 0.5
        total = np.float32(0.0)
        for tile in range(tiles):
            x0, y0, x1, y1 = rects[tile, 0], rects[tile, 1], rects[tile, 2], rects[tile, 3]
            inside = x >= x0 and x <= x1 and y >= y0 and y <= y1
            if not (inside and x1 > x0 and y1 > y0):
                continue
            weight = one
            if tiles > 1:
                # 1e-6 keeps a point on the very edge of its only tile.
                tent = min(x - x0, x1 - x) / (x1 - x0) * min(y - y0, y1 - y) / (y1 - y0) + 1e-6
                weight = np.float32(tent)
            column = min(max(x * across[tile, 0] + across[tile, 1], 0.0), columns - 1.0)
            row = min(max(y * down[tile, 0] + down[tile, 1], 0.0), rows - 1.0)
            c, r = min(int(column), max(columns - 2, 0)), min(int(row), max(rows - 2, 0))
            a, b = np.float32(column - c), np.float32(row - r)
            w00, w01 = weight * ((one - a) * (one - b)), weight * (a * (one - b))
            w10, w11 = weight * ((one - a) * b), weight * (a * b)
            # Over all channels, and with indices that cannot count from the end: vectors then.
            t, r0, c0 = np.uint64(tile), np.uint64(r), np.uint64(c)
            r1, c1 = r0 + below, c0 + right
            for k in range(channels):
                result[i, k] += (
                    w00 * np.float32(grid[t, r0, c0, k])
                    + w01 * np.float32(grid[t, r0, c1, k])
                    + w10 * np.float32(grid[t, r1, c0, k])
                    + w11 * np.float32(grid[t, r1, c1, k])
                )
            total += weight
        if total > 0.0:
            covered[i] = True
            gain = np.float32(scale) / total
            for k in range(channels):
                result[i, k] = result[i, k] * gain - shift
            for k in range(classes, 16):
                result[i, k] = 0.0
    return result, covered


@compiled
def _cells_per_pixel(low: float, high: float, cells: int) -> Any:
    """a, b of the cell a x + b at pixel edge x, along an axis of a tile from `low` to `high`."""
    a = cells / (np.float64(high) - low)
    b = -0.5 - low * a
    return (a, b) if np.isfinite(a + b) else (0.0, 0.0)  # of an endless tile its first cell
