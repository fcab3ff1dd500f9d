"""What a surface looks like at a point: its color, and the windows in its facade.

The camera, the thermal camera and the LiDAR read the same windows at the same (u, v): glass mirrors
for the one, is cold for the other and swallows the third one's light.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled
from stages.simulation.materials import Material
from stages.simulation.noise import chance, fractal_noise, value_noise

#: What a point of a facade is.
WALL, FRAME, PANE, DOOR, PLINTH = 0, 1, 2, 3, 4

_ASPHALT, _STREET, _ZEBRA = int(Material.ASPHALT), int(Material.STREET), int(Material.ZEBRA)
_KERB, _PAVING, _LAWN = int(Material.KERB), int(Material.PAVING), int(Material.LAWN)
_BRICK, _PLASTER = int(Material.FACADE_BRICK), int(Material.FACADE_PLASTER)
_TILES, _FLAT = int(Material.ROOF_TILES), int(Material.ROOF_FLAT)
_BARK, _LEAF, _WOOD = int(Material.BARK), int(Material.LEAF), int(Material.WOOD)
_STRIPES, _GRAVEL, _CLOTH = int(Material.STRIPES), int(Material.GRAVEL), int(Material.CLOTH)
_METAL = int(Material.METAL)


@compiled
def is_facade(material: int) -> Any:
    """Whether the material has windows."""
    return material in (_BRICK, _PLASTER)


@compiled
def facade_part(u: float, v: float, width: float, height: float, seed: float) -> Any:
    """(part, window): what a facade of `width` x `height` m is at (u, v), and the window's number.

    Floors are 2.9 m over a plinth of 0.5 m; windows stand in bays of equal width. A seed of 0.5 and
    above has a door in the middle of its ground floor.
    """
    if height < 1.0:
        return WALL, 0
    if v < 0.5:
        near_door = seed >= 0.5 and abs(u - width / 2) < 0.6
        return (DOOR if near_door else PLINTH), 0
    style = seed * 2.0 - math.floor(seed * 2.0)
    bays = max(1, int(width / (2.3 + 0.9 * style)))
    bay = width / bays
    column = min(int(u / bay), bays - 1)
    floor = int((v - 0.5) / 2.9)
    across = u - (column + 0.5) * bay
    up = v - 0.5 - floor * 2.9
    if seed >= 0.5 and floor == 0 and abs(u - width / 2) < 1.0:
        if up < 1.75 and abs(u - width / 2) < 0.55:
            return DOOR, 0
        return (FRAME if up < 1.9 and abs(u - width / 2) < 0.68 else WALL), 0
    half = 0.5 + 0.22 * style
    sill, top = 0.75, 2.2
    if abs(across) > half + 0.09 or up < sill - 0.1 or up > top + 0.07:
        return WALL, 0
    if abs(across) > half or up < sill or up > top:
        return FRAME, 0
    if abs(across) < 0.04 or abs(up - (sill + 0.68 * (top - sill))) < 0.03:
        return FRAME, 0
    return PANE, 1 + column + 64 * floor


@compiled
def color_at(
    material: int,
    look: NDArray[np.float32],
    row: int,
    x: float,
    y: float,
    z: float,
    u: float,
    v: float,
    footprint: float,
) -> Any:
    """(red, green, blue, pane): linear color 0..1, and the window's number where there is glass.

    `row` is the surface in `look`; x, y, z the point in its own frame, m;
    `footprint` the size of a pixel on it, m.
    """
    r, g, b = float(look[row, 0]), float(look[row, 1]), float(look[row, 2])
    width, height, seed = float(look[row, 3]), float(look[row, 4]), float(look[row, 5])
    pane = 0
    shade = 1.0
    if material in (_ASPHALT, _STREET, _ZEBRA):
        coarse = fractal_noise(x * 0.35, y * 0.35, footprint * 0.35, 4, 11)
        grain = fractal_noise(x * 22.0, y * 22.0, footprint * 22.0, 2, 17)
        shade = 0.55 + 0.65 * coarse + 0.5 * (grain - 0.5)
        wear = 0.75 + 0.5 * fractal_noise(x * 3.0, y * 3.0, footprint * 3.0, 3, 23)
        white = 0.0
        if material == _STREET:
            if abs(v - height * 0.5) < 0.07 and u - 6.0 * math.floor(u / 6.0) < 3.0:
                white = 1.0
            lane = min(abs(v - 2.1), abs(v - height + 2.1))
            if lane < 0.05 and u - math.floor(u) < 0.6:
                white = 0.8
        elif material == _ZEBRA and v - math.floor(v) < 0.5:
            white = 1.0
        white *= min(1.0, wear)
        r, g, b = r + (0.62 - r) * white, g + (0.62 - g) * white, b + (0.60 - b) * white
    elif material == _PAVING:
        i, j = math.floor(x / 0.5), math.floor(y / 0.5)
        fade = min(max(0.5 / max(footprint, 1e-4) * 0.25 - 0.25, 0.0), 1.0)
        joint = min(x - 0.5 * i, y - 0.5 * j) < 0.025
        tone = 0.2 * (chance(int(i), int(j), 31) - 0.5) - (0.4 if joint else 0.0)
        shade = 0.7 + 0.6 * fractal_noise(x * 0.6, y * 0.6, footprint * 0.6, 4, 37) + fade * tone
    elif material == _KERB:
        along = x + y
        joint = along - math.floor(along) < 0.03 and footprint < 0.05
        shade = (0.7 if joint else 0.95) + 0.3 * (value_noise(x * 4.0, y * 4.0, 41) - 0.5)
    elif material == _LAWN:
        wide = fractal_noise(x * 0.12, y * 0.12, footprint * 0.12, 4, 43)
        blades = fractal_noise(x * 9.0, y * 9.0, footprint * 9.0, 3, 47)
        shade = 0.65 + 0.5 * wide + 0.75 * (blades - 0.5)
        r *= 0.75 + 0.6 * wide
        b *= 1.2 - 0.4 * wide
    elif material == _GRAVEL:
        shade = 0.6 + 0.5 * fractal_noise(x * 0.5, y * 0.5, footprint * 0.5, 4, 53)
        shade += 0.7 * (fractal_noise(x * 18.0, y * 18.0, footprint * 18.0, 2, 59) - 0.5)
    elif material in (_BRICK, _PLASTER):
        part, window = facade_part(u, v, width, height, seed)
        shade = 0.78 + 0.44 * fractal_noise(
            u * 0.4, v * 0.4, footprint * 0.4, 4, 61 + int(seed * 999)
        )
        # Rain leaves streaks below the sills and darkens the foot of the wall.
        shade *= 1.0 - 0.16 * value_noise(u * 3.1, v * 0.35, 67)
        if height >= 1.0:
            shade *= 0.86 + 0.14 * min(1.0, v / 2.0)
        if part == PANE:
            r, g, b, shade, pane = 0.045, 0.055, 0.06, 1.0, window
        elif part == FRAME:
            r, g, b = 0.68, 0.67, 0.64
        elif part == DOOR:
            tone = 0.15 + 0.3 * chance(int(seed * 9999), 3, 71)
            r, g, b, shade = tone, 0.35 * tone, 0.2 * tone, 0.9
        elif part == PLINTH:
            r, g, b = 0.30, 0.29, 0.28
        elif material == _BRICK:
            course = math.floor(v / 0.085)
            shift = 0.5 * (course - 2.0 * math.floor(course / 2.0))
            brick = math.floor(u / 0.26 + shift)
            fade = min(max(0.085 / max(footprint, 1e-4) * 0.4 - 0.4, 0.0), 1.0)
            mortar = v - 0.085 * course < 0.012 or u / 0.26 + shift - brick < 0.045
            tone = 0.5 * (chance(int(brick), int(course), 73) - 0.5)
            shade *= 1.0 + fade * tone
            if mortar:
                grey = 0.36 * fade
                r, g, b = r + (0.42 - r) * grey, g + (0.40 - g) * grey, b + (0.38 - b) * grey
    elif material == _TILES:
        row_v = v / 0.32
        course = math.floor(row_v)
        shift = 0.5 * (course - 2.0 * math.floor(course / 2.0))
        tile = math.floor(u / 0.24 + shift)
        fade = min(max(0.3 / max(footprint, 1e-4) * 0.4 - 0.4, 0.0), 1.0)
        round_u = u / 0.24 + shift - tile
        relief = 0.45 * (row_v - course - 0.5) + 0.35 * (0.5 - abs(round_u - 0.5) - 0.25)
        tone = 0.35 * (chance(int(tile), int(course), 79) - 0.5)
        shade = 0.75 + 0.5 * fractal_noise(u * 0.5, v * 0.5, footprint * 0.5, 3, 83)
        shade *= 1.0 + fade * (relief + tone)
    elif material == _FLAT:
        shade = 0.6 + 0.8 * fractal_noise(x * 0.4, y * 0.4, footprint * 0.4, 4, 89)
    elif material == _BARK:
        shade = 0.5 + fractal_noise((x + y) * 14.0, z * 3.0, footprint * 14.0, 3, 97)
    elif material == _LEAF:
        shade = 0.55 + 0.9 * fractal_noise(x * 2.2 + z, y * 2.2 - z, footprint * 2.2, 3, 101)
        warm = value_noise(x * 0.7, y * 0.7 + z, 103)
        r *= 0.8 + 0.5 * warm
    elif material == _WOOD:
        shade = 0.65 + 0.7 * fractal_noise(x * 3.0, (y + z) * 11.0, footprint * 11.0, 3, 107)
    elif material == _STRIPES:
        if u / 0.5 - math.floor(u / 0.5) < 0.5:
            r, g, b = 0.72, 0.71, 0.68
    elif material == _CLOTH:
        shade = 0.72 + 0.56 * fractal_noise(
            (x + y) * 9.0, z * 7.0, footprint * 9.0, 3, 109 + int(seed * 99)
        )
    elif material == _METAL and seed > 0.0:  # ribbed: the shutters of lockers
        shade = 0.8 if z / 0.08 - math.floor(z / 0.08) < 0.3 else 1.0
    return r * shade, g * shade, b * shade, pane
