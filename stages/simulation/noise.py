"""Random numbers that are a function of their place: for textures and for sensor noise.

Seeding with a linear combination of row and column shows as a grid in the drop-outs of a LiDAR, so
every coordinate is mixed on its own. The mixer is `lowbias32` (C. Wellons, "Prospecting for hash
functions", 2018).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from stages.kernels.compiled import compiled


@compiled
def mix(value: Any) -> Any:
    """A 32-bit integer scrambled, as uint32."""
    x = np.uint32(value)
    x ^= x >> np.uint32(16)
    x = np.uint32(x * np.uint32(0x7FEB352D))
    x ^= x >> np.uint32(15)
    x = np.uint32(x * np.uint32(0x846CA68B))
    x ^= x >> np.uint32(16)
    return x


@compiled
def scrambled(i: int, j: int, salt: int) -> Any:
    """32 random bits of two integers and a salt."""
    return mix(np.uint32(i) ^ mix(np.uint32(j) + np.uint32(salt) * np.uint32(0x9E3779B1)))


@compiled
def chance(i: int, j: int, salt: int) -> Any:
    """A uniform number in [0, 1) of two integers and a salt."""
    return scrambled(i, j, salt) * 2.3283064365386963e-10


@compiled
def bell(bits: int) -> Any:
    """A number of variance 1, about normal, of 32 random bits: the sum of its four bytes.

    Bounded by 3.5: enough for a pixel's noise, at a tenth of the cost of a logarithm and a cosine.
    """
    x = np.uint32(bits)
    a = x & np.uint32(0xFF00FF)
    b = (x >> np.uint32(8)) & np.uint32(0xFF00FF)
    total = np.uint32(a + b)
    total = (total & np.uint32(0xFFFF)) + (total >> np.uint32(16))
    # Four bytes, each of variance (256^2 - 1) / 12.
    return (float(total) - 510.0) * (1.0 / 147.8)


@compiled
def value_noise(x: float, y: float, salt: int) -> Any:
    """Smooth noise in [0, 1] with features of unit size."""
    left, low = math.floor(x), math.floor(y)
    a, b = x - left, y - low
    a, b = a * a * (3.0 - 2.0 * a), b * b * (3.0 - 2.0 * b)
    i, j = int(left), int(low)
    bottom = chance(i, j, salt) * (1.0 - a) + chance(i + 1, j, salt) * a
    top = chance(i, j + 1, salt) * (1.0 - a) + chance(i + 1, j + 1, salt) * a
    return bottom * (1.0 - b) + top * b


@compiled
def fractal_noise(x: float, y: float, footprint: float, octaves: int, salt: int) -> Any:
    """Octaves of value noise about 0.5, each half as strong and twice as fine as the one before.

    An octave fades out where its features are smaller than twice the `footprint` (in the unit of x
    and y), so that distant textures are plain and not speckled.
    """
    total, weight, size = 0.5, 0.5, 1.0
    for octave in range(octaves):
        fade = min(max(size / max(footprint, 1e-6) * 0.5 - 0.5, 0.0), 1.0)
        if fade <= 0.0:
            break
        total += weight * fade * (value_noise(x / size, y / size, salt + octave) - 0.5)
        weight *= 0.6
        size *= 0.5
    return total
