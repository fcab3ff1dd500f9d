"""Triangles with what shading needs, and the solids that objects are put together from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stages.simulation.materials import Material

Color = tuple[float, float, float]  #: linear RGB, 0..1
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Surface:
    """What all triangles of one surface share."""

    material: Material
    color: Color = (0.5, 0.5, 0.5)
    size: tuple[float, float] = (1.0, 1.0)  #: extent of its u and v, m
    seed: float = 0.0  #: 0..1, varies the texture


@dataclass(slots=True)
class Mesh:
    """A growing set of triangles, each of one surface of one thing (an object with an identity)."""

    corners: list[Array] = field(default_factory=list)  #: (n, 3, 3) m
    normals: list[Array] = field(default_factory=list)  #: (n, 3, 3) at the corners, unit length
    uv: list[Array] = field(default_factory=list)  #: (n, 3, 2) m
    surface_of: list[NDArray[np.int32]] = field(default_factory=list)  #: (n,)
    surfaces: list[Surface] = field(default_factory=list)
    things: list[int] = field(default_factory=list)  #: the thing of each surface

    def add(
        self,
        thing: int,
        surface: Surface,
        corners: Array,
        normals: Array | None = None,
        uv: Array | None = None,
    ) -> None:
        """Append triangles (n, 3, 3); flat normals and uv along the surface unless given."""
        if normals is None:
            flat = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
            normals = np.repeat(flat[:, None], 3, axis=1)
        if uv is None:
            uv = corners[..., :2] + corners[..., 2:]
        self.corners.append(corners)
        self.normals.append(normals)
        self.uv.append(uv)
        self.surface_of.append(np.full(len(corners), len(self.surfaces), dtype=np.int32))
        self.surfaces.append(surface)
        self.things.append(thing)

    def insert(self, other: Mesh, pose: Array) -> None:
        """Append a mesh, moved by a rigid transform (4, 4)."""
        rotation, offset = pose[:3, :3], pose[:3, 3]
        self.corners += [part @ rotation.T + offset for part in other.corners]
        self.normals += [part @ rotation.T for part in other.normals]
        self.uv += other.uv
        self.surface_of += [part + np.int32(len(self.surfaces)) for part in other.surface_of]
        self.surfaces += other.surfaces
        self.things += other.things

    def quad(self, thing: int, surface: Surface, corners: ArrayLike) -> None:
        """A flat quadrilateral (4, 3), counterclockwise seen from outside; u from corner 0 to 1, v
        from 0 to 3, over the surface's size."""
        a, b, c, d = np.asarray(corners, dtype=np.float64)
        w, h = surface.size
        uv = np.array([[[0, 0], [w, 0], [w, h]], [[0, 0], [w, h], [0, h]]], dtype=np.float64)
        self.add(thing, surface, np.array([[a, b, c], [a, c, d]]), uv=uv)

    def triangle(self, thing: int, surface: Surface, corners: ArrayLike) -> None:
        """A single triangle (3, 3)."""
        self.add(thing, surface, np.asarray(corners, dtype=np.float64)[None])

    def box(
        self,
        thing: int,
        surface: Surface,
        center: ArrayLike,
        size: ArrayLike,
        yaw: float = 0.0,
        *,
        bottom: bool = False,
    ) -> None:
        """A box turned about z; without its bottom unless it can be seen from below."""
        signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        ring = turned(signs * np.asarray(size)[:2] / 2, yaw) + np.asarray(center)[:2]
        low = np.asarray(center)[2] - np.asarray(size)[2] / 2
        self.prism(thing, surface, ring, low, low + np.asarray(size)[2], bottom=bottom)

    def prism(
        self,
        thing: int,
        surface: Surface,
        ring: Array,
        low: float,
        high: float,
        *,
        bottom: bool = False,
        top: bool = True,
    ) -> None:
        """A convex ring (k, 2), counterclockwise from above, drawn up from `low` to `high`."""
        floor, roof = at_height(ring, low), at_height(ring, high)
        after = np.roll(np.arange(len(ring)), -1)
        sides = np.concatenate(
            [
                np.stack([floor, floor[after], roof[after]], axis=1),
                np.stack([floor, roof[after], roof], axis=1),
            ]
        )
        parts = [sides]
        if top:
            parts.append(_fan(roof))
        if bottom:
            parts.append(_fan(floor[::-1]))
        self.add(thing, surface, np.concatenate(parts))

    def tube(
        self,
        thing: int,
        surface: Surface,
        path: ArrayLike,
        radii: Sequence[float] | float,
        sides: int = 8,
    ) -> None:
        """A round tube along a path (k, 3), of a radius per point, closed at both ends."""
        line = np.asarray(path, dtype=np.float64)
        radius = np.broadcast_to(np.asarray(radii, dtype=np.float64), len(line))
        along = _unit(np.gradient(line, axis=0))
        # One direction that no segment is parallel to keeps the rings from twisting.
        across = np.eye(3)[np.argmin(np.abs(along).max(axis=0))]
        side = _unit(np.cross(along, across))
        up = np.cross(along, side)
        angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
        spokes = (
            np.cos(angle)[None, :, None] * side[:, None]
            + np.sin(angle)[None, :, None] * up[:, None]
        )
        rings = line[:, None] + radius[:, None, None] * spokes
        self._skin(thing, surface, rings, spokes)
        for ring, flip in ((rings[0], True), (rings[-1], False)):
            self.add(thing, surface, _fan(ring[::-1] if flip else ring))

    def ellipsoid(
        self,
        thing: int,
        surface: Surface,
        center: ArrayLike,
        radii: ArrayLike,
        sides: int = 10,
        stacks: int = 7,
    ) -> None:
        """An ellipsoid with its axes along x, y and z."""
        polar = np.linspace(-np.pi / 2, np.pi / 2, stacks)[:, None]
        angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)[None, :]
        ball = np.stack(
            np.broadcast_arrays(
                np.cos(polar) * np.cos(angle), np.cos(polar) * np.sin(angle), np.sin(polar)
            ),
            axis=-1,
        )
        scale = np.asarray(radii, dtype=np.float64)
        self._skin(thing, surface, np.asarray(center) + ball * scale, _unit(ball / scale))

    def _skin(self, thing: int, surface: Surface, rings: Array, normals: Array) -> None:
        """Join neighboring rings (k, sides, 3) with smooth normals (k, sides, 3)."""
        sides = rings.shape[1]
        after = np.roll(np.arange(sides), -1)

        def strips(values: Array) -> Array:
            low, high = values[:-1], values[1:]
            one = np.stack([low, low[:, after], high[:, after]], axis=2)
            two = np.stack([low, high[:, after], high], axis=2)
            return np.asarray(np.concatenate([one, two]).reshape(-1, 3, 3))

        self.add(thing, surface, strips(rings), strips(normals))


def standing(x: float, y: float, yaw: float = 0.0, z: float = 0.0) -> Array:
    """The pose (4, 4) of an upright object."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1]], dtype=np.float64)


def at_height(ring: Array, z: float) -> Array:
    """The points (k, 2) as (k, 3) at one height."""
    return np.column_stack([ring, np.full(len(ring), z)])


def turned(points: Array, yaw: float) -> Array:
    """Points (k, 2) turned about the origin, radians counterclockwise."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.asarray(points @ np.array([[c, s], [-s, c]]))


def _fan(ring: Array) -> Array:
    """Triangles (k - 2, 3, 3) of a convex ring (k, 3)."""
    k = len(ring)
    return np.stack([np.repeat(ring[:1], k - 2, axis=0), ring[1:-1], ring[2:]], axis=1)


def _unit(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-12))
