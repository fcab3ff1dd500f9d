"""What is left of houses: partly collapsed walls and floors, and heaps of rubble.

What stands is of the class building; rubble, which no label set of the networks knows, is object.
"""

from __future__ import annotations

import numpy as np

from stages.simulation.buildings import FLOOR_M
from stages.simulation.materials import Material
from stages.simulation.mesh import Array, Color, Mesh, Surface, standing

STRIP_M = 0.7  #: a broken wall's edge jumps once in this length
SLAB_M = 1.5  #: floors break in squares of this size
_BASE_M = 0.5  #: plinth, as of a whole house
_LEFT = 0.10  #: share of the height that is left in the corner that collapsed

_CONCRETE: tuple[Color, ...] = ((0.34, 0.33, 0.31), (0.42, 0.40, 0.37), (0.26, 0.25, 0.24))
_PLASTERS: tuple[Color, ...] = ((0.58, 0.53, 0.43), (0.56, 0.54, 0.50), (0.50, 0.40, 0.32))
_BRICK: Color = (0.34, 0.14, 0.09)
_DEBRIS: Color = (0.20, 0.18, 0.155)


def ruin(
    thing: int, heap: int, random: np.random.Generator, width: float, depth: float, floors: int
) -> Mesh:
    """A house as `buildings.house` places it, of which a corner at the front came down: walls with
    broken edges, floors that end in the air, and the thing `heap` of rubble at its foot."""
    mesh = Mesh()
    height = _BASE_M + floors * FLOOR_M
    x, y = width / 2, depth / 2
    ring = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    fallen = ring[int(random.integers(2))]
    brick = bool(random.random() < 0.4)
    color = _BRICK if brick else _PLASTERS[random.integers(len(_PLASTERS))]
    material = Material.FACADE_BRICK if brick else Material.FACADE_PLASTER
    seed = random.random() / 2
    for k in range(4):
        _broken_wall(mesh, thing, ring[k], ring[(k + 1) % 4], height, fallen, random,
                     (material, color, seed))  # fmt: skip
    concrete = Surface(Material.PLAIN, _CONCRETE[random.integers(len(_CONCRETE))])
    for floor in range(1, floors + 1):
        _broken_floor(mesh, thing, concrete, (x, y), _BASE_M + floor * FLOOR_M, height, fallen,
                      random)  # fmt: skip
    outward = fallen / np.linalg.norm(fallen)
    for away, radius, high in ((-0.8, 4.2, 0.32), (2.2, 2.6, 0.14)):
        place = fallen + outward * away
        pile = rubble(heap, random, radius * random.uniform(0.9, 1.2), height * high)
        mesh.insert(pile, standing(place[0], place[1], random.uniform(0, 2 * np.pi)))
    return mesh


def rubble(thing: int, random: np.random.Generator, radius_m: float, height_m: float) -> Mesh:
    """A heap on z = 0: a rough cone of debris with slabs, bricks, beams and bent bars on it."""
    mesh = Mesh()
    _cone(mesh, thing, random, radius_m, height_m)
    for _ in range(int(12 * radius_m)):
        away = radius_m * np.sqrt(random.random()) * 1.08
        angle = random.uniform(0, 2 * np.pi)
        z = height_m * max(0.0, 1.0 - away / radius_m)
        draw = random.random()
        if draw < 0.45:
            size = random.uniform([0.3, 0.25, 0.10], [1.3, 0.9, 0.24]) * min(1.0, radius_m / 2)
            surface = Surface(Material.PLAIN, _CONCRETE[random.integers(len(_CONCRETE))])
        elif draw < 0.8:
            size = random.uniform([0.22, 0.11, 0.08], [0.5, 0.3, 0.25])
            surface = Surface(Material.FACADE_BRICK, _BRICK, (0.0, 0.0), random.random())
        elif draw < 0.93:
            size = np.array([random.uniform(0.9, 2.2), 0.1, 0.12])
            surface = Surface(Material.WOOD, (0.26, 0.19, 0.12))
        else:
            size = np.array([random.uniform(0.8, 1.8), 0.03, 0.03])
            surface = Surface(Material.METAL, (0.20, 0.12, 0.08))
        piece = Mesh()
        piece.box(thing, surface, (0, 0, 0), size, bottom=True)
        pose = _tumbled(random)
        pose[:3, 3] = [away * np.cos(angle), away * np.sin(angle), z + 0.3 * size[2]]
        mesh.insert(piece, pose)
    return mesh


def _standing_share(points: Array, fallen: Array) -> Array:
    """(n,) how much of the full height is left over places (n, 2) of the ground plan, 0..1."""
    reach = 2 * np.linalg.norm(fallen)  # the diagonal: `fallen` is a corner about the middle
    away = np.linalg.norm(points - fallen, axis=-1) / reach
    return np.asarray(np.clip(1.9 * away - 0.22, _LEFT, 1.0))


def _broken_wall(
    mesh: Mesh,
    thing: int,
    start: Array,
    stop: Array,
    height: float,
    fallen: Array,
    random: np.random.Generator,
    look: tuple[Material, Color, float],
) -> None:
    """A wall in strips of their own heights; windows go on over the strips. It is 30 cm thick."""
    material, color, seed = look
    length = float(np.linalg.norm(stop - start))
    along = (stop - start) / length
    inward = np.array([-along[1], along[0]]) * 0.3
    surface = Surface(material, color, (length, height), seed)
    edge = Surface(Material.FACADE_BRICK, _BRICK, (0.0, 0.0), seed)
    count = max(2, round(length / STRIP_M))
    at = np.linspace(0.0, length, count + 1)
    middles = start + along * ((at[:-1] + at[1:]) / 2)[:, None]
    tops = height * _standing_share(middles, fallen)
    tops = np.where(tops < height, tops + random.normal(0, 0.45, count), height)
    tops = np.clip(tops, 0.3, height)
    for u0, u1, top in zip(at[:-1], at[1:], tops, strict=True):
        a, b = start + along * u0, start + along * u1
        face = np.array([(*a, 0), (*b, 0), (*b, top), (*a, top)])
        uv = np.array([(u0, 0), (u1, 0), (u1, top), (u0, top)])
        inner = face + np.array([*inward, 0])
        for corners, order in ((face, (0, 1, 2, 3)), (inner, (1, 0, 3, 2))):
            quad, place = corners[list(order)], uv[list(order)]
            mesh.add(thing, surface, _halves(quad), uv=_halves(place))
        for corners in (
            [face[3], face[2], inner[2], inner[3]],
            [face[0], face[3], inner[3], inner[0]],
            [face[2], face[1], inner[1], inner[2]],
        ):
            mesh.quad(thing, edge, corners)


def _broken_floor(
    mesh: Mesh,
    thing: int,
    surface: Surface,
    half: tuple[float, float],
    z: float,
    height: float,
    fallen: Array,
    random: np.random.Generator,
) -> None:
    """Squares of a floor where the house still stands that high."""
    x, y = (side - 0.32 for side in half)
    columns, rows = max(2, round(2 * x / SLAB_M)), max(2, round(2 * y / SLAB_M))
    dx, dy = 2 * x / columns, 2 * y / rows
    for i in range(columns):
        for j in range(rows):
            middle = np.array([-x + (i + 0.5) * dx, -y + (j + 0.5) * dy])
            left = height * float(_standing_share(middle, fallen)) + random.normal(0, 0.3)
            if left > z - 0.2:
                center = (*middle, z - 0.11)
                mesh.box(thing, surface, center, (dx, dy, 0.22), bottom=True)


def _cone(
    mesh: Mesh, thing: int, random: np.random.Generator, radius_m: float, height_m: float
) -> None:
    """Rings of uneven height about the top."""
    surface = Surface(Material.GRAVEL, _DEBRIS, seed=random.random())
    sides, rings = 22, 7
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    uneven = random.uniform(0.8, 1.15, (rings, sides))
    points = np.empty((rings, sides, 3))
    for k in range(rings):
        away = radius_m * (1 - k / rings) * uneven[k]
        points[k, :, 0], points[k, :, 1] = away * np.cos(angle), away * np.sin(angle)
        points[k, :, 2] = height_m * k / rings * random.uniform(0.7, 1.25, sides)
    after = np.roll(np.arange(sides), -1)
    low, high = points[:-1], points[1:]
    faces = [
        np.stack([low, low[:, after], high[:, after]], axis=2).reshape(-1, 3, 3),
        np.stack([low, high[:, after], high], axis=2).reshape(-1, 3, 3),
    ]
    top = np.broadcast_to([0.0, 0.0, height_m], (sides, 3))
    faces.append(np.stack([points[-1], points[-1][after], top], axis=1))
    mesh.add(thing, surface, np.concatenate(faces))


def _tumbled(random: np.random.Generator) -> Array:
    """A pose (4, 4) at the origin: turned any way about z, tilted up to 50 degrees."""
    yaw, tilt = random.uniform(0, 2 * np.pi), random.uniform(-0.9, 0.9)
    c, s = np.cos(tilt), np.sin(tilt)
    lean = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1.0]])
    return np.asarray(standing(0.0, 0.0, yaw) @ lean)


def _halves(quad: Array) -> Array:
    """Two triangles (2, 3, k) of four corners (4, k)."""
    return np.stack([quad[[0, 1, 2]], quad[[0, 2, 3]]])
