"""How scans are varied while a network learns, by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError


@dataclass(frozen=True, slots=True)
class ScanRecipe:
    """Changes to the points of a scan, drawn anew for each; all turn about z by any angle."""

    name: str
    flip: float = 0.5  #: share that is mirrored, left for right
    scale: float = 0.0  #: +- share by which the world grows
    shift_m: float = 0.0  #: +- along x and y: other places in the same street
    lift_m: float = 0.0  #: +- along z
    tilt_rad: float = 0.0  #: +- about x and about y: how a vehicle leans
    lose: float = 0.5  #: share of the scans that lose points
    lost: float = 0.5  #: the most that one loses, as a share
    gain: float = 0.0  #: +- of the remission, as a share
    offset: float = 0.0  #: +- of the remission
    deaf: float = 0.0  #: share of the scans whose remission is told as 0


#: `plain` is what a network learns its own sensor with; `strong` what it is retrained with, from
#: labels of one place (the paper asks for a stronger augmentation and does not say which).
RECIPES = {
    one.name: one
    for one in (
        ScanRecipe("plain"),
        ScanRecipe(
            "strong",
            scale=0.05,
            shift_m=2.0,
            lift_m=0.1,
            tilt_rad=0.02,
            lose=0.75,
            lost=0.4,
            gain=0.2,
            offset=0.03,
        ),
        ScanRecipe(
            "across-sensors",  # another LiDAR's remission and height: lean on shape
            scale=0.1,
            shift_m=3.0,
            lift_m=0.5,
            tilt_rad=0.1,
            lose=0.75,
            lost=0.5,
            gain=0.5,
            offset=0.1,
            deaf=0.25,
        ),
    )
}


def recipe_named(name: str) -> ScanRecipe:
    """Raises DataError with the names there are."""
    if name not in RECIPES:
        raise DataError(f"no recipe '{name}' (known: {', '.join(RECIPES)})")
    return RECIPES[name]


def varied(
    points: NDArray[np.float32],
    remission: NDArray[np.float32],
    recipe: ScanRecipe,
    yaw_rad: float,
    mirrored: bool,
    random: np.random.Generator,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Points (n, 3) and remissions (n,) mirrored, turned by the yaw, changed by the recipe, and
    which (n,) of them are still there."""
    matrix = _turn_z(yaw_rad) @ _lean(random.uniform(-1, 1, 2) * recipe.tilt_rad)
    if mirrored:
        matrix = matrix @ np.diag([1.0, -1.0, 1.0])
    matrix *= 1 + random.uniform(-1, 1) * recipe.scale
    shift = random.uniform(-1, 1, 3) * np.array([recipe.shift_m, recipe.shift_m, recipe.lift_m])
    real = (points != 0).any(axis=1)
    moved = (points @ matrix.T.astype(np.float32) + shift.astype(np.float32)).astype(np.float32)
    moved[~real] = 0.0
    loud = remission * (1 + random.uniform(-1, 1) * recipe.gain)
    loud = loud + random.uniform(-1, 1) * recipe.offset
    if random.random() < recipe.deaf:
        loud = np.zeros_like(loud)
    share = random.uniform(0, recipe.lost) * (random.random() < recipe.lose)
    here = real & (random.random(len(points)) >= share)
    return moved, np.clip(loud, 0, 1).astype(np.float32), here


def azimuth_of_column(column: float, columns: int) -> float:
    """Where a column of a range image looks, rad: column 0 straight behind, going clockwise."""
    return float(np.pi - 2 * np.pi * (column + 0.5) / columns)


def _turn_z(angle_rad: float) -> NDArray[Any]:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def _lean(angles_rad: NDArray[np.float64]) -> NDArray[Any]:
    (cx, cy), (sx, sy) = np.cos(angles_rad), np.sin(angles_rad)
    about_x = np.array([[1.0, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1.0, 0], [-sy, 0, cy]])
    return np.asarray(about_x @ about_y)
