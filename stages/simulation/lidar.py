"""A spinning LiDAR: every column at its own time and place, ranges with noise, drop-outs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled
from stages.simulation.hits import FACING, Hits, U, V, resolve
from stages.simulation.materials import MATERIALS
from stages.simulation.noise import bell, chance, scrambled
from stages.simulation.textures import FRAME, PANE, WALL, facade_part, is_facade
from stages.simulation.trace import DX, NOTHING, OX, PACKET, TILE, Packet, Scene, T, trace


@compiled
def sweep(
    scene: Scene,
    packet: Packet,
    hits: Hits,
    first_column: int,
    last_column: int,
    world_from_column: NDArray[np.float32],
    azimuths: NDArray[np.float64],
    elevations: NDArray[np.float64],
    min_m: float,
    max_m: float,
    full_m: float,
    noise_m: float,
    dust: float,
    salt: int,
    ranges: NDArray[np.float32],
    reflectivity: NDArray[np.float32],
    things: NDArray[np.uint16],
) -> None:
    """Fill the columns from `first_column` up to `last_column` of `ranges`, `reflectivity` and
    `things` (rows, columns).

    `world_from_column` (columns, 3, 4) is the sensor's pose at each column's time; rays leave
    along `azimuths` (columns,) and `elevations` (rows,), rad. `full_m` is where a head-on target
    of 10 % reflectivity is detected half the time: further out, at grazing angles and on glass
    returns are lost, and in dust, whose extinction per m is `dust`. A range of 0 is no return; its
    thing is 0.
    """
    rows = ranges.shape[0]
    rays = packet.rays
    for left in range(first_column, last_column, TILE[1]):
        for top in range(0, rows, TILE[0]):
            for k in range(PACKET):
                column = min(left + k % TILE[1], last_column - 1)
                row = min(top + k // TILE[1], rows - 1)
                level = math.cos(elevations[row])
                x = level * math.cos(azimuths[column])
                y = level * math.sin(azimuths[column])
                z = math.sin(elevations[row])
                for axis in range(3):
                    m = world_from_column[column, axis]
                    rays[OX + axis, k] = m[3]
                    rays[DX + axis, k] = m[0] * x + m[1] * y + m[2] * z
                rays[T, k] = max_m
            trace(scene, packet, False)
            resolve(scene, packet, hits)
            for k in range(PACKET):
                column, row = left + k % TILE[1], top + k // TILE[1]
                if column >= last_column or row >= rows:
                    continue
                ranges[row, column] = 0.0
                reflectivity[row, column] = 0.0
                things[row, column] = 0
                if hits.surface[k] == NOTHING:
                    continue
                distance = float(rays[T, k])
                shine, facing = _returned(hits, k, scene.look)
                strength = shine * (0.1 + 0.9 * facing) / 0.1 * (full_m / max(distance, 1.0)) ** 2
                strength *= math.exp(-2.0 * dust * distance)
                found = strength**3 / (strength**3 + 1.0)  # lost over a narrow band of strengths
                if chance(row, column, salt) > found or distance < min_m:
                    continue
                # Where the beam grazes, its footprint smears the range.
                spread = noise_m * (1.0 + 0.5 * (1.0 - facing))
                ranges[row, column] = distance + spread * bell(scrambled(row, column, salt + 1))
                seen = shine * (1.0 + 0.06 * bell(scrambled(row, column, salt + 2)))
                reflectivity[row, column] = min(max(seen, 0.004), 1.0)
                things[row, column] = hits.thing[k]


@compiled
def _returned(hits: Hits, k: int, look: NDArray[np.float32]) -> Any:
    """(reflectivity, cosine of incidence) of what ray `k` meets."""
    surface, material = hits.surface[k], hits.material[k]
    facing, u, v = float(hits.rows[FACING, k]), hits.rows[U, k], hits.rows[V, k]
    shine = float(MATERIALS[material, 0])
    # Two paints of one kind differ about as their brightness does.
    bright = float(look[surface, 0] + look[surface, 1] + look[surface, 2]) / 3.0
    shine *= 0.75 + 0.6 * min(bright, 0.8)
    if is_facade(material):
        part, _ = facade_part(u, v, look[surface, 3], look[surface, 4], look[surface, 5])
        if part == PANE:
            shine = 0.012 + 0.5 * max(0.0, facing - 0.97)
        elif part == FRAME:
            shine = 0.6
        elif part != WALL:
            shine *= 0.8
    return shine, facing
