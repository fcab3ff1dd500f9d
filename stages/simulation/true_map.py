"""The true voxel map: what surfaces pass through each voxel, and which of them can be seen."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled
from stages.labels import LabeledVoxels
from stages.simulation.mesh import Mesh
from stages.simulation.scene import Model
from stages.simulation.trace import DX, OX, PACKET, Packet, Scene, T, trace

#: Triangles are sampled at this part of a voxel's edge.
_SAMPLES_PER_VOXEL = 2.5
#: What can be seen is decided from places so far apart along the flight.
_EYES_M = 2.0
#: Surface that is seen from nowhere weighs so much of what is: it decides where nothing is seen.
_UNSEEN = 1e-6
#: A ray to the eye starts off its surface by so much.
_LIFT_M = 0.003


def voxel_truth(
    still: Mesh,
    classes: NDArray[np.uint8],
    track: NDArray[np.float64],
    voxel_m: float = 0.25,
    reach_m: float = 50.0,
) -> LabeledVoxels:
    """The voxels that the surfaces of what stands still pass through, within `reach_m` of the
    track (n, 3) on the ground; each of the class with the largest share of its surface.

    Only surface that can be seen from the track counts, if there is any: no sensor can tell that
    the lawn goes on under a house, or that the wheels of a car have an inner side.
    """
    corners = np.concatenate(still.corners)
    surface = np.concatenate(still.surface_of)
    kind = classes[np.array(still.things)[surface]]
    level = np.ascontiguousarray(track[:, :2])
    low, high = level.min(axis=0) - reach_m, level.max(axis=0) + reach_m
    near = ((corners[..., :2].min(1) < high) & (corners[..., :2].max(1) > low)).all(axis=1)
    step = voxel_m / _SAMPLES_PER_VOXEL
    keys, areas, points = _pieces(corners[near], kind[near], low, high, voxel_m, step)
    close = _within(points, level, reach_m)
    keys, areas, points = keys[close], areas[close], points[close]

    unique, number = np.unique(keys, return_inverse=True)
    voxel = unique >> 4
    _, place, classes_in = np.unique(voxel, return_inverse=True, return_counts=True)
    disputed = classes_in[place] > 1
    hidden = np.flatnonzero(disputed[number])
    scene, packet = Model.of(still, ()).scene, Packet.new()
    for eye in _eyes(track):
        hidden = hidden[~_sees(scene, packet, eye, points[hidden])]
    areas[hidden] *= _UNSEEN

    share = np.bincount(number, weights=areas)
    # By voxel, the class with the largest share last: it is the one that is kept.
    order = np.lexsort((share, voxel))
    last = np.append(voxel[order][1:] != voxel[order][:-1], True)
    chosen = unique[order[last]]
    offset = 1 << 19
    indices = np.stack([(chosen >> 4 + s & 0xFFFFF) - offset for s in (40, 20, 0)], axis=1)
    return LabeledVoxels(voxel_m, indices.astype(np.int32), (chosen & 15).astype(np.uint8))


def _eyes(track: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k, 3) places on the track, `_EYES_M` apart."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(track, axis=0), axis=1))])
    return track[np.searchsorted(way, np.arange(0.0, way[-1] + 1e-9, _EYES_M))]


@compiled
def _pieces(
    corners: NDArray[np.float64],
    classes: NDArray[np.uint8],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    voxel_m: float,
    step: float,
) -> Any:
    """The surface of triangles (n, 3, 3) between `low` and `high` (2,) in pieces of one voxel and
    class: keys (three indices of 20 bits, a class of 4), areas (m2), a point (3,) float32 of each.

    Samples that follow each other in one voxel are one piece, up to `step` squared of area: a car
    or a bush has thousands of triangles smaller than that.
    """
    keys = np.empty(1 << 16, dtype=np.int64)
    areas = np.empty(len(keys), dtype=np.float64)
    points = np.empty((len(keys), 3), dtype=np.float32)
    count = 0
    sample = np.empty(3)
    for i in range(len(corners)):
        a, u, v = corners[i, 0], corners[i, 1] - corners[i, 0], corners[i, 2] - corners[i, 0]
        across = max(1, int(np.ceil(np.sqrt((u * u).sum()) / step)))
        along = max(1, int(np.ceil(np.sqrt((v * v).sum()) / step)))
        x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        samples = 0
        for j in range(across):
            samples += int((1.0 - (j + 0.33) / across) * along + 0.67)
        area = 0.5 * math.sqrt(x * x + y * y + z * z) / max(samples, 1)
        for j in range(across):
            b = (j + 0.33) / across
            for k in range(along):
                c = (k + 0.33) / along
                if b + c > 1.0:
                    break
                for axis in range(3):
                    sample[axis] = a[axis] + b * u[axis] + c * v[axis]
                beyond = sample[0] < low[0] or sample[1] < low[1]
                if beyond or sample[0] > high[0] or sample[1] > high[1]:
                    continue
                key = np.int64(0)
                for axis in range(3):
                    key = key << 20 | (np.int64(np.floor(sample[axis] / voxel_m)) + (1 << 19))
                key = key << 4 | classes[i]
                if count > 0 and keys[count - 1] == key and areas[count - 1] < step * step:
                    areas[count - 1] += area
                    continue
                if count == len(keys):
                    keys, areas, points = _doubled(keys), _doubled(areas), _doubled(points)
                keys[count], areas[count] = key, area
                for axis in range(3):
                    points[count, axis] = sample[axis]
                count += 1
    return keys[:count], areas[:count], points[:count]


@compiled
def _doubled(array: Any) -> Any:
    grown = np.empty((2 * len(array), *array.shape[1:]), dtype=array.dtype)
    grown[: len(array)] = array
    return grown


@compiled
def _within(points: NDArray[np.float32], track: NDArray[np.float64], reach_m: float) -> Any:
    """(n,) bool: a place of the track (k, 2) is near the point (n, 3), seen from above."""
    close = np.zeros(len(points), dtype=np.bool_)
    for i in range(len(points)):
        for p in range(len(track)):
            dx, dy = points[i, 0] - track[p, 0], points[i, 1] - track[p, 1]
            if dx * dx + dy * dy < reach_m * reach_m:
                close[i] = True
                break
    return close


@compiled
def _sees(
    scene: Scene, packet: Packet, eye: NDArray[np.float64], points: NDArray[np.float32]
) -> Any:
    """(n,) bool: nothing stands between the eye (3,) and the point (n, 3)."""
    free = np.zeros(len(points), dtype=np.bool_)
    rays = packet.rays
    for first in range(0, len(points), PACKET):
        for k in range(PACKET):
            i = min(first + k, len(points) - 1)
            x, y, z = eye[0] - points[i, 0], eye[1] - points[i, 1], eye[2] - points[i, 2]
            away = math.sqrt(x * x + y * y + z * z)
            for axis, way in enumerate((x, y, z)):
                rays[OX + axis, k] = points[i, axis] + way / away * _LIFT_M
                rays[DX + axis, k] = way / away
            rays[T, k] = away - _LIFT_M
        trace(scene, packet, True)
        for k in range(min(PACKET, len(points) - first)):
            free[first + k] = rays[T, k] > 0.0
    return free
