"""Trees and hedges: ragged in the image, and penetrable for a LiDAR."""

from __future__ import annotations

import numpy as np

from stages.simulation.materials import Material
from stages.simulation.mesh import Array, Color, Mesh, Surface

_GREENS: tuple[Color, ...] = (
    (0.07, 0.15, 0.025),
    (0.10, 0.18, 0.03),
    (0.055, 0.12, 0.035),
    (0.14, 0.17, 0.03),
)


def tree(thing: int, random: np.random.Generator, *, fine: bool = True) -> Mesh:
    """A broad-leaved tree, 6 to 11 m high; `fine` where a camera comes near."""
    mesh = Mesh()
    height = random.uniform(6.0, 11.0)
    crown = height * random.uniform(0.26, 0.34)
    bark = Surface(Material.BARK, (0.13, 0.09, 0.06), seed=random.random())
    middle = np.array([0.0, 0.0, height - crown * 0.95])
    bend = random.normal(0, 0.12, (4, 3)) * [1, 1, 0]
    bend[0] = 0
    trunk = np.linspace([0, 0, 0], middle, 4) + bend
    mesh.tube(thing, bark, trunk, (0.2, 0.16, 0.13, 0.07), sides=8)
    green = _GREENS[random.integers(len(_GREENS))]
    blobs = []
    for k in range(9):
        direction = random.normal(0, 1, 3)
        direction /= np.linalg.norm(direction)
        offset = direction * crown * random.uniform(0.45, 0.75) * [1, 1, 0.85]
        center = middle + (0 if k == 0 else offset)
        radius = crown * (random.uniform(0.42, 0.6) if k else 0.62)
        blobs.append((center, radius))
        if k and k < 6:
            mesh.tube(thing, bark, [trunk[2], (trunk[2] + center) / 2, center], 0.05, sides=5)
    dark = Surface(Material.LEAF, _scaled(green, 0.55), seed=random.random())
    for center, radius in blobs:
        mesh.ellipsoid(thing, dark, center, np.full(3, radius * 0.74), 8, 6)
    for center, radius in blobs:
        shade = _scaled(green, random.uniform(0.8, 1.25))
        leaves = Surface(Material.LEAF, shade, seed=random.random())
        count, size = (340, 0.15) if fine else (110, 0.29)
        ball = random.normal(0, 1, (count, 3))
        ball *= radius / np.linalg.norm(ball, axis=1, keepdims=True)
        ball *= random.uniform(0.72, 1.08, (count, 1))
        _leaves(mesh, thing, leaves, center + ball, ball, size, random)
    return mesh


def conifer(thing: int, random: np.random.Generator) -> Mesh:
    """A fir, 5 to 10 m high."""
    mesh = Mesh()
    height = random.uniform(5.0, 10.0)
    bark = Surface(Material.BARK, (0.10, 0.07, 0.05), seed=random.random())
    mesh.tube(thing, bark, [(0, 0, 0), (0, 0, height * 0.9)], (0.16, 0.03), sides=7)
    green = (0.035, 0.085, 0.035)
    for part in np.linspace(0.12, 0.97, 11):
        reach = height * 0.22 * (1.05 - part)
        count = int(30 + 110 * (1 - part))
        angle = random.uniform(0, 2 * np.pi, count)
        out = reach * np.sqrt(random.uniform(0.15, 1.0, count))
        z = part * height + (reach - out) * 0.55 + random.normal(0, 0.06, count)
        at = np.column_stack([out * np.cos(angle), out * np.sin(angle), z])
        leaves = Surface(Material.LEAF, _scaled(green, random.uniform(0.8, 1.2)))
        _leaves(mesh, thing, leaves, at, at * [1, 1, 0] + np.array([0.0, 0.0, 0.3]), 0.30, random)
        core = Surface(Material.LEAF, _scaled(green, 0.5))
        mesh.tube(thing, core, [(0, 0, z.min()), (0, 0, z.max())], (reach * 0.55, 0.05), sides=7)
    return mesh


def hedge(thing: int, random: np.random.Generator, length: float, height: float) -> Mesh:
    """A trimmed hedge along x, its middle at the origin."""
    mesh = Mesh()
    green = _GREENS[random.integers(len(_GREENS))]
    seed = random.random()
    core = Surface(Material.LEAF, _scaled(green, 0.7), seed=seed)
    mesh.box(thing, core, (0, 0, height / 2 - 0.03), (length, 0.55, height - 0.06))
    count = int(length * (height * 2 + 0.7) * 26)
    where = random.uniform(-1, 1, (count, 3)) * [length / 2, 0.3, height / 2]
    face = random.integers(0, 5, count)
    where[face < 2, 1] = -0.29
    where[(face >= 2) & (face < 4), 1] = 0.29
    where[face == 4, 2] = height / 2
    outward = np.column_stack([np.zeros(count), np.sign(where[:, 1]), face == 4]).astype(float)
    leaves = Surface(Material.LEAF, green, seed=seed)
    _leaves(mesh, thing, leaves, where + np.array([0.0, 0.0, height / 2]), outward, 0.13, random)
    return mesh


def bush(thing: int, random: np.random.Generator, radius: float) -> Mesh:
    """A round bush on the ground."""
    mesh = Mesh()
    green = _GREENS[random.integers(len(_GREENS))]
    core = Surface(Material.LEAF, _scaled(green, 0.6), seed=random.random())
    mesh.ellipsoid(thing, core, (0, 0, radius * 0.7), np.full(3, radius * 0.8), 8, 6)
    ball = random.normal(0, 1, (130, 3))
    ball *= radius / np.linalg.norm(ball, axis=1, keepdims=True)
    ball[:, 2] = np.abs(ball[:, 2])
    leaves = Surface(Material.LEAF, green, seed=random.random())
    _leaves(mesh, thing, leaves, ball + np.array([0.0, 0.0, radius * 0.5]), ball, 0.2, random)
    return mesh


def _leaves(
    mesh: Mesh,
    thing: int,
    surface: Surface,
    where: Array,
    outward: Array,
    size: float,
    random: np.random.Generator,
) -> None:
    """Random triangles about the points (n, 3), shaded as if they faced `outward` (n, 3)."""
    spread = random.normal(0, size, (len(where), 3, 3))
    length = np.linalg.norm(outward, axis=1, keepdims=True)
    facing = outward / np.maximum(length, 1e-9)
    normals = np.repeat(facing[:, None], 3, axis=1) + random.normal(0, 0.35, spread.shape)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    mesh.add(thing, surface, where[:, None] + spread, normals)


def _scaled(color: Color, factor: float) -> Color:
    r, g, b = color
    return (r * factor, g * factor, b * factor)
