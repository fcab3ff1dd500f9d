"""The street that emulated sensors look at and emulated networks know: boxes, met ray by ray.

What stands still is endless along x and what moves keeps the vehicle's pace, so the street looks
the same from everywhere on a flight along x, at any speed. A sensor therefore looks once, when it
opens, and its stream still fits the poses, the other sensors and its own past.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.warp import viewing_rays
from stages.taxonomy import load_taxonomy
from stages.types import Camera

#: The vehicle's base above the road, m.
ALTITUDE_M = 4.0

#: How far the street goes both ways, m: farther than any sensor sees.
END_M = 1000.0

#: Class and two opposite corners, m: x ahead of the vehicle, y to its left, z above the road.
BOXES: tuple[tuple[str, tuple[float, float, float], tuple[float, float, float]], ...] = (
    ("road", (-END_M, -5.0, -1.0), (END_M, 5.0, 0.0)),
    ("sidewalk", (-END_M, 5.0, -1.0), (END_M, 7.5, 0.12)),
    ("sidewalk", (-END_M, -7.5, -1.0), (END_M, -5.0, 0.12)),
    ("building", (-END_M, -14.0, -1.0), (END_M, -7.5, 9.0)),
    ("barrier", (-END_M, 7.5, -1.0), (END_M, 7.7, 1.1)),
    ("vegetation", (-END_M, 7.7, -1.0), (END_M, 16.0, 0.3)),
    ("vegetation", (-END_M, 11.0, -1.0), (END_M, 13.0, 3.2)),
    ("building", (-END_M, 16.0, -1.0), (END_M, 24.0, 7.0)),
    ("vehicle", (9.5, -3.4, 0.3), (13.9, -1.6, 1.5)),
    ("vehicle", (17.0, 1.2, 0.3), (22.5, 3.4, 2.6)),
    ("vehicle", (-13.0, 1.4, 0.3), (-8.6, 3.2, 1.5)),
    ("person", (8.0, 2.6, 0.0), (8.5, 3.1, 1.75)),
    ("person", (11.0, 5.6, 0.12), (11.5, 6.2, 1.85)),
    ("person", (-6.0, -6.6, 0.12), (-5.5, -6.0, 1.8)),
    ("bicycle", (12.4, -0.35, 0.0), (14.1, 0.05, 1.05)),
)


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What rays meet first."""

    distance: NDArray[np.float32]  #: (...) in lengths of the ray's direction; inf in the sky
    label: NDArray[np.uint8]  #: (...) id of the taxonomy


def look_along(directions: NDArray[np.floating[Any]], base_from_sensor: NDArray[Any]) -> Sight:
    """What the rays of a sensor meet: `directions` (..., 3) in its own frame."""
    taxonomy = load_taxonomy()
    turn = base_from_sensor[:3, :3].astype(np.float32)
    start = base_from_sensor[:3, 3] + (0.0, 0.0, ALTITUDE_M)
    distance = np.full(directions.shape[:-1], np.inf, dtype=np.float32)
    label = np.full(distance.shape, taxonomy.id("sky"), dtype=np.uint8)
    with np.errstate(divide="ignore", invalid="ignore"):  # 0 * inf: a ray within a face meets none
        per_meter = [np.float32(1.0) / (directions @ row) for row in turn]
        for name, low, high in BOXES:
            enters, leaves = np.zeros_like(distance), distance.copy()
            for axis in range(3):
                one = np.float32(low[axis] - start[axis]) * per_meter[axis]
                other = np.float32(high[axis] - start[axis]) * per_meter[axis]
                np.maximum(enters, np.minimum(one, other), out=enters)
                np.minimum(leaves, np.maximum(one, other), out=leaves)
            met = enters < leaves  # and so nearer than what was met before
            distance[met] = enters[met]
            label[met] = taxonomy.id(name)
    return Sight(distance, label)


def look_through(camera: Camera, base_from_camera: NDArray[np.float64]) -> Sight:
    """What each pixel (height, width) of a camera meets; the distance is the depth Z, m."""
    across, down = viewing_rays(*camera.size, camera.intrinsics())
    return look_along(np.stack([across, down, np.ones_like(down)], axis=-1), base_from_camera)


def lidar_rays(rows: int, columns: int) -> NDArray[np.float32]:
    """(rows, columns, 3) unit vectors through the cells of a range image over +-45 deg, the
    highest row first, the columns clockwise from behind (eq 18)."""
    elevation = np.pi / 2 * (0.5 - (np.arange(rows) + 0.5) / rows)[:, None]
    azimuth = np.pi * (1.0 - 2.0 * (np.arange(columns) + 0.5) / columns)[None, :]
    flat = np.cos(elevation)
    rays = flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)
    return np.stack(np.broadcast_arrays(*rays), axis=-1).astype(np.float32)


def painted(label: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(..., 3) RGB: everything has the color of its class."""
    return load_taxonomy().colors[label]


def painted_gray(label: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(...) gray: every class has its own, and those that move are bright, as what is warm is."""
    return _grays()[label]


def read_classes(paint: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The classes (...) of RGB (..., 3) or gray (..., 1) paint; another color is background."""
    if paint.shape[-1] == 1:
        return _class_of_gray()[paint[..., 0]]
    return _class_of_color()[_color_key(paint)]


def _color_key(rgb: NDArray[np.uint8]) -> NDArray[np.int64]:
    """The four high bits of each channel, in which the colors of the classes differ."""
    red, green, blue = (rgb[..., channel].astype(np.int64) >> 4 for channel in range(3))
    return np.asarray(red << 8 | green << 4 | blue)


@cache
def _grays() -> NDArray[np.uint8]:
    taxonomy = load_taxonomy()
    steps = np.arange(0, 6 * len(taxonomy), 6)
    return np.asarray(np.where(taxonomy.dynamic, 160, 20) + steps, dtype=np.uint8)


@cache
def _class_of_gray() -> NDArray[np.uint8]:
    table = np.zeros(256, dtype=np.uint8)
    table[_grays()] = np.arange(len(_grays()))
    return table


@cache
def _class_of_color() -> NDArray[np.uint8]:
    table = np.zeros(1 << 12, dtype=np.uint8)
    colors = load_taxonomy().colors
    table[_color_key(colors)] = np.arange(len(colors))
    return table
