"""What stands about in streets: lamps, signs, fences, barriers, benches, bins."""

from __future__ import annotations

import numpy as np

from stages.simulation.materials import Material
from stages.simulation.mesh import Color, Mesh, Surface

_STEEL = Surface(Material.METAL, (0.30, 0.32, 0.32))
_WOOD = Surface(Material.WOOD, (0.28, 0.17, 0.09))
_WHITE = Surface(Material.PLAIN, (0.75, 0.75, 0.74))


def street_lamp(thing: int) -> Mesh:
    """A mast of 6.5 m whose arm reaches along +x."""
    mesh = Mesh()
    path = [(0, 0, 0), (0, 0, 5.6), (0.25, 0, 6.2), (1.3, 0, 6.5)]
    mesh.tube(thing, _STEEL, path, (0.09, 0.06, 0.05, 0.04), sides=8)
    lamp = Surface(Material.LIGHT, (0.75, 0.74, 0.66))
    mesh.box(thing, _STEEL, (1.6, 0, 6.53), (0.7, 0.26, 0.10))
    mesh.box(thing, lamp, (1.6, 0, 6.46), (0.6, 0.2, 0.05), bottom=True)
    return mesh


def sign(thing: int, random: np.random.Generator) -> Mesh:
    """A round, square or triangular sign on a post, facing +x."""
    mesh = Mesh()
    mesh.tube(thing, _STEEL, [(0, 0, 0), (0, 0, 2.7)], 0.035, sides=6)
    colors: tuple[Color, ...] = ((0.60, 0.02, 0.02), (0.02, 0.08, 0.45), (0.70, 0.52, 0.02))
    color = Surface(Material.PLAIN, colors[random.integers(3)])
    sides = int(random.choice([3, 4, 16]))
    for radius, surface, x in ((0.33, color, 0.05), (0.22, _WHITE, 0.065)):
        mesh.tube(thing, surface, [(x, 0, 2.4), (x + 0.015, 0, 2.4)], radius, sides=sides)
    return mesh


def fence(thing: int, length: float, color: Color) -> Mesh:
    """A picket fence along x, its middle at the origin."""
    mesh = Mesh()
    wood = Surface(Material.WOOD, color)
    for z in (0.3, 0.8):
        mesh.box(thing, wood, (0, 0.02, z), (length, 0.04, 0.09), bottom=True)
    for x in np.arange(-length / 2 + 0.06, length / 2, 0.17):
        mesh.box(thing, wood, (x, -0.02, 0.56), (0.1, 0.03, 1.0))
    return mesh


def barrier(thing: int) -> Mesh:
    """A red and white barrier of a building site, 2 m along x."""
    mesh = Mesh()
    boards = Surface(Material.STRIPES, (0.62, 0.03, 0.02))
    for z in (0.5, 0.95):
        mesh.box(thing, boards, (0, 0, z), (2.0, 0.05, 0.22), bottom=True)
    for x in (-0.85, 0.85):
        mesh.box(thing, _STEEL, (x, 0, 0.55), (0.05, 0.05, 1.1))
        mesh.box(
            thing, Surface(Material.RUBBER, (0.04, 0.04, 0.04)), (x, 0, 0.06), (0.3, 0.7, 0.12)
        )
    return mesh


def bench(thing: int) -> Mesh:
    """A bench along x that faces -y."""
    mesh = Mesh()
    for y in (-0.22, -0.07, 0.08):
        mesh.box(thing, _WOOD, (0, y, 0.46), (1.7, 0.12, 0.04), bottom=True)
    for z in (0.65, 0.82):
        mesh.box(thing, _WOOD, (0, 0.2, z), (1.7, 0.04, 0.12), bottom=True)
    for x in (-0.7, 0.7):
        mesh.box(thing, _STEEL, (x, 0, 0.23), (0.06, 0.44, 0.46))
        mesh.box(thing, _STEEL, (x, 0.22, 0.65), (0.06, 0.05, 0.5))
    return mesh


def bin_on_wheels(thing: int, color: Color) -> Mesh:
    """A household bin, its front to -y."""
    mesh = Mesh()
    body = Surface(Material.PLAIN, color)
    mesh.box(thing, body, (0, 0, 0.55), (0.55, 0.6, 0.96), bottom=True)
    mesh.box(thing, Surface(Material.PLAIN, (0.05, 0.05, 0.05)), (0, -0.02, 1.06), (0.6, 0.7, 0.07))
    return mesh


def bicycle_stand(thing: int) -> Mesh:
    """A hoop to lock a bicycle to, along x."""
    mesh = Mesh()
    path = [
        (-0.35, 0, 0),
        (-0.35, 0, 0.7),
        (-0.25, 0, 0.8),
        (0.25, 0, 0.8),
        (0.35, 0, 0.7),
        (0.35, 0, 0),
    ]
    mesh.tube(thing, _STEEL, path, 0.025, sides=6)
    return mesh
