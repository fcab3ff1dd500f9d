"""What a stereo camera makes of the true depth: range limits, occlusion, disparity noise.

Noise, steps and gaps arise in disparity, d = f b / z, so the error of z grows with its square: with
the D455's baseline of 95 mm and 0.05 px about 0.0012 z^2 m.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled
from stages.simulation.noise import bell, scrambled


@compiled
def stereo_depth(
    depth: NDArray[np.float32],
    focal_px: float,
    baseline_m: float,
    noise_px: float,
    step_px: float,
    min_m: float,
    max_m: float,
    unit_m: float,
    salt: int,
    result: NDArray[np.uint16],
) -> None:
    """Fill `result` (h, w) with depth in counts of `unit_m`, 0 where there is none.

    `depth` (h, w) is the true z, m, 0 for the sky. A pixel that the right imager cannot see, behind
    the left edge of something nearer, has no depth. Disparity noise is smooth over blocks of 4 x 4
    pixels, as a correlation window makes it, and disparities come in steps of `step_px`.
    """
    height, width = depth.shape
    for row in range(height):
        nearest = -1e9  # the leftmost column of the right image that is taken, from the right edge
        for column in range(width - 1, -1, -1):
            z = depth[row, column]
            disparity = focal_px * baseline_m / z if z > 0.0 else 0.0
            position = column - disparity
            hidden = column < width - 1 and position > nearest + 0.75
            if column == width - 1 or position < nearest:
                nearest = position
            result[row, column] = 0
            if z <= 0.0 or hidden:
                continue
            shared = bell(scrambled(row // 4, column // 4, salt))
            error = 0.92 * shared + 0.39 * bell(scrambled(row, column, salt + 1))
            seen = disparity + noise_px * error
            seen = step_px * math.floor(seen / step_px + 0.5)
            if seen <= 0.0:
                continue
            measured = focal_px * baseline_m / seen
            if min_m <= measured <= max_m:
                result[row, column] = min(int(measured / unit_m + 0.5), 65535)
