"""Class scores at pixels, taken from score grids at any stride, in one or more tiles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled


@compiled
def sample_scores(
    grid: NDArray[Any],
    rects: NDArray[np.float32],
    scale: float,
    zero_point: float,
    align_corners: bool,
    pixel: NDArray[np.float32],
    classes: int,
) -> Any:
    """Log scores at pixels u v (m, 2), bilinear in the grid, without dequantizing the grid.

    `grid` (tiles, rows, columns, channels) float32, int8 or uint8, in any strides; value = (grid -
    zero_point) * scale. `rects` (tiles, 4) x0 y0 x1 y1 are the pixel edges that each tile covers:
    pixel u lies at u + 0.5. With `align_corners` the outer grid cells lie on the centers of the
    rectangle's corner pixels, else the rectangle is divided evenly into cells; beyond the outer
    centers the outer cells hold. Where tiles overlap they are averaged with tent weights, greatest
    in a tile's center and 0 on its edge.

    Returns (m, 16) float32 with 0 in the channels from `classes` on, and (m,) bool: some tile
    covers the pixel (else the row is 0).
    """
    tiles, rows, columns = grid.shape[0], grid.shape[1], grid.shape[2]
    result = np.zeros((len(pixel), 16), dtype=np.float32)
    covered = np.zeros(len(pixel), dtype=np.bool_)
    for i in range(len(pixel)):
        x, y = pixel[i, 0] + 0.5, pixel[i, 1] + 0.5
        total = np.float32(0.0)
        for tile in range(tiles):
            x0, y0, x1, y1 = rects[tile, 0], rects[tile, 1], rects[tile, 2], rects[tile, 3]
            if x < x0 or x > x1 or y < y0 or y > y1:
                continue
            if align_corners:
                column = (x - x0 - 0.5) / max(x1 - x0 - 1.0, 1.0) * (columns - 1)
                row = (y - y0 - 0.5) / max(y1 - y0 - 1.0, 1.0) * (rows - 1)
            else:
                column = (x - x0) / (x1 - x0) * columns - 0.5
                row = (y - y0) / (y1 - y0) * rows - 0.5
            column = min(max(column, 0.0), columns - 1.0)
            row = min(max(row, 0.0), rows - 1.0)
            c0, r0 = min(int(column), max(columns - 2, 0)), min(int(row), max(rows - 2, 0))
            c1, r1 = min(c0 + 1, columns - 1), min(r0 + 1, rows - 1)
            a, b = np.float32(column - c0), np.float32(row - r0)
            # 1e-6 keeps a point on the very edge of its only tile.
            tent = min(x - x0, x1 - x) / (x1 - x0) * min(y - y0, y1 - y) / (y1 - y0) + 1e-6
            weight = np.float32(tent)
            w00, w01 = weight * (1 - a) * (1 - b), weight * a * (1 - b)
            w10, w11 = weight * (1 - a) * b, weight * a * b
            for k in range(classes):
                result[i, k] += (
                    w00 * np.float32(grid[tile, r0, c0, k])
                    + w01 * np.float32(grid[tile, r0, c1, k])
                    + w10 * np.float32(grid[tile, r1, c0, k])
                    + w11 * np.float32(grid[tile, r1, c1, k])
                )
            total += weight
        if total > 0.0:
            covered[i] = True
            gain = np.float32(scale / total)
            shift = np.float32(zero_point * scale)
            for k in range(classes):
                result[i, k] = result[i, k] * gain - shift
    return result, covered
