"""Houses with textured facades and gabled or flat roofs."""

from __future__ import annotations

import numpy as np

from stages.simulation.materials import Material
from stages.simulation.mesh import Array, Color, Mesh, Surface

FLOOR_M = 2.9  #: height of a floor
_BASE_M = 0.5  #: plinth below the ground floor

_PLASTERS: tuple[Color, ...] = (
    (0.62, 0.56, 0.42),
    (0.66, 0.63, 0.57),
    (0.60, 0.42, 0.28),
    (0.48, 0.55, 0.58),
    (0.62, 0.50, 0.24),
    (0.50, 0.56, 0.44),
    (0.58, 0.36, 0.30),
)
_BRICKS: tuple[Color, ...] = ((0.36, 0.13, 0.08), (0.30, 0.16, 0.11), (0.42, 0.24, 0.15))
_TILES: tuple[Color, ...] = ((0.36, 0.12, 0.06), (0.24, 0.09, 0.06), (0.11, 0.11, 0.12))


def house(thing: int, random: np.random.Generator, width: float, depth: float, floors: int) -> Mesh:
    """A house on z = 0; its front of `width` m faces -y, the middle of its floor is the origin."""
    mesh = Mesh()
    brick = random.random() < 0.4
    palette = _BRICKS if brick else _PLASTERS
    color = palette[random.integers(len(palette))]
    material = Material.FACADE_BRICK if brick else Material.FACADE_PLASTER
    seed = random.random()
    height = _BASE_M + floors * FLOOR_M
    x, y = width / 2, depth / 2
    ring = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    for k in range(4):
        a, b = ring[k], ring[(k + 1) % 4]
        size = (float(np.linalg.norm(b - a)), height)
        # The front has the door: textures read it off a seed of 0.5 and above.
        surface = Surface(material, color, size, seed / 2 + (0.5 if k == 0 else 0.0))
        mesh.quad(thing, surface, [(*a, 0), (*b, 0), (*b, height), (*a, height)])
    if floors >= 3 and random.random() < 0.45:
        _flat_roof(mesh, thing, ring, height, color, random)
    else:
        _gable_roof(mesh, thing, x, y, height, (material, color), random)
    _front_door_step(mesh, thing, y)
    return mesh


def _gable_roof(
    mesh: Mesh,
    thing: int,
    x: float,
    y: float,
    height: float,
    wall: tuple[Material, Color],
    random: np.random.Generator,
) -> None:
    """A ridge along x, with eaves and a chimney."""
    tiles = _TILES[random.integers(len(_TILES))]
    rise = y * random.uniform(0.65, 0.95)
    over = 0.4
    eave = height - over * rise / y
    length = float(np.hypot(y + over, rise + over * rise / y))
    roof = Surface(Material.ROOF_TILES, tiles, (2 * (x + over), length), random.random())
    top, out, low = height + rise, x + over, y + over
    mesh.quad(thing, roof, [(-out, -low, eave), (out, -low, eave), (out, 0, top), (-out, 0, top)])
    mesh.quad(thing, roof, [(out, low, eave), (-out, low, eave), (-out, 0, top), (out, 0, top)])
    under = Surface(Material.WOOD, (0.30, 0.24, 0.18))
    for side in (-1, 1):
        near, far = (-side * out, side * low), (side * out, side * low)
        drop = eave - 0.12
        mesh.quad(thing, under, [(*near, drop), (*far, drop), (*far, eave), (*near, eave)])
        gable = Surface(wall[0], wall[1], (0.0, 0.0))
        mesh.triangle(
            thing,
            gable,
            [(side * x, -side * y, height), (side * x, side * y, height), (side * x, 0, top)],
        )
    stack = Surface(Material.FACADE_BRICK, (0.30, 0.13, 0.09), (0.0, 0.0))
    mesh.box(thing, stack, (x * random.uniform(-0.6, 0.6), y * 0.25, top - 0.1), (0.7, 0.6, 1.6))
    for side in (-1, 1):
        if random.random() < 0.5:
            _dormer(mesh, thing, side, y, height, rise, random.uniform(-0.5, 0.5) * x)


def _dormer(
    mesh: Mesh, thing: int, side: int, y: float, height: float, rise: float, x: float
) -> None:
    """A dormer window on the roof's side -1 (front) or 1."""
    wall = Surface(Material.PLAIN, (0.55, 0.53, 0.48))
    glass = Surface(Material.GLASS, (0.05, 0.06, 0.07))
    lead = Surface(Material.METAL, (0.20, 0.21, 0.22))
    z = height + rise * 0.36
    mesh.box(thing, wall, (x, side * y * 0.50, z), (1.7, y * 0.6, 1.3))
    mesh.box(thing, glass, (x, side * (y * 0.80), z + 0.05), (1.2, 0.03, 0.9))
    mesh.box(thing, lead, (x, side * y * 0.50, z + 0.72), (2.0, y * 0.68, 0.14), bottom=True)


def _flat_roof(
    mesh: Mesh,
    thing: int,
    ring: Array,
    height: float,
    color: Color,
    random: np.random.Generator,
) -> None:
    """Bitumen behind a parapet, with vents."""
    roof = Surface(Material.ROOF_FLAT, (0.15, 0.15, 0.15))
    mesh.quad(thing, roof, np.column_stack([ring, np.full(4, height - 0.02)]))
    rim = Surface(Material.PLAIN, tuple(0.8 * c for c in color))  # type: ignore[arg-type]
    x, y = ring[2]
    for side in (-1, 1):
        mesh.box(thing, rim, (0, side * y, height + 0.15), (2 * x + 0.2, 0.3, 0.5), bottom=True)
        mesh.box(thing, rim, (side * x, 0, height + 0.15), (0.3, 2 * y + 0.2, 0.5), bottom=True)
    vent = Surface(Material.METAL, (0.45, 0.46, 0.47))
    for _ in range(3):
        at = (random.uniform(-0.7, 0.7) * x, random.uniform(-0.6, 0.6) * y, height + 0.4)
        mesh.box(thing, vent, at, (random.uniform(0.5, 1.6), 0.8, 0.9))


def _front_door_step(mesh: Mesh, thing: int, y: float) -> None:
    step = Surface(Material.KERB, (0.42, 0.41, 0.39))
    mesh.box(thing, step, (0, -y - 0.35, 0.1), (1.7, 0.7, 0.2))
