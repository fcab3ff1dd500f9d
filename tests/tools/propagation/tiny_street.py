"""A street of a few points for the tests of label propagation: what each voxel is, is written here.

A sensor drives along x, 1.5 m above the road. Cameras see only what lies ahead of it within 6 m.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stages.observed import Observation, Said, write_observation
from stages.types import PADDING_LOG

ROAD, BUILDING, PERSON, SKY, VEHICLE = 3, 1, 5, 8, 13
HEIGHT_M = 1.5
SIGHT_M = 6.0


def rows(classes: NDArray[np.integer], probability: float = 0.95) -> NDArray[np.float16]:
    """(n, 16) log scores that give each class so much."""
    scores = np.full((len(classes), 16), np.log((1 - probability) / 14), np.float32)
    scores[:, 15] = PADDING_LOG
    scores[np.arange(len(classes)), classes] = np.log(probability)
    return scores.astype(np.float16)


def world() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points on the map of a road and a wall, each in a voxel of its own, and their classes."""
    x, y = np.meshgrid(np.arange(-10, 10, 0.25) + 0.125, np.arange(-2, 2, 0.25) + 0.125)
    road = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.05)])
    x, z = np.meshgrid(np.arange(-10, 10, 0.25) + 0.125, np.arange(0.5, 3, 0.25) + 0.125)
    wall = np.column_stack([x.ravel(), np.full(x.size, 2.1), z.ravel()])
    classes = np.concatenate([np.full(len(road), ROAD), np.full(len(wall), BUILDING)])
    return np.concatenate([road, wall]), classes


def observation(
    number: int,
    at_x: float,
    *,
    extra: tuple[NDArray[np.float64], NDArray[np.int64]] | None = None,
    said: NDArray[np.int64] | None = None,
    probability: float = 0.95,
    degraded: bool = False,
    fused: NDArray[np.int64] | None = None,
) -> Observation:
    """Scan `number` from x, 0.1 s after the one before. `extra` points are in this scan alone;
    `said` (n,) what the cameras take the points for (as they are); `fused` the same with LiDAR."""
    points, classes = world()
    if extra is not None:
        points, classes = np.concatenate([points, extra[0]]), np.concatenate([classes, extra[1]])
    pose = np.eye(4)
    pose[:3, 3] = [at_x, 0, HEIGHT_M]
    local = (points - pose[:3, 3]).astype(np.float32)
    seen = np.flatnonzero((local[:, 0] > 0) & (local[:, 0] < SIGHT_M)).astype(np.int32)
    taken = classes if said is None else said
    everything = np.arange(len(points), dtype=np.int32)
    return Observation(
        stamp=number * 100_000_000,
        points=local,
        remission=np.full(len(points), 0.5, np.float32),
        shape=None,
        sensor="lidar",
        map_from_sensor=pose,
        camera=Said(seen, rows(taken[seen], probability)),
        fused=None if fused is None else Said(everything, rows(fused)),
        degraded=degraded,
    )


def written(folder: Path, observations: list[Observation]) -> list[Path]:
    """The files of the observations."""
    files = []
    for one in observations:
        files.append(folder / f"{one.stamp:020d}.npz")
        write_observation(files[-1], one)
    return files
