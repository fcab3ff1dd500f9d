"""Cars, vans and a fire truck; each faces +x and stands on z = 0 with its middle at the origin."""

from __future__ import annotations

import numpy as np

from stages.simulation.materials import Material
from stages.simulation.mesh import Array, Color, Mesh, Surface

GLASS = Surface(Material.GLASS, (0.05, 0.07, 0.08))
TRIM = Surface(Material.RUBBER, (0.03, 0.03, 0.035))
HUB = Surface(Material.METAL, (0.45, 0.46, 0.48))
LAMP = Surface(Material.LIGHT, (0.85, 0.85, 0.80))
TAIL = Surface(Material.LIGHT, (0.55, 0.03, 0.02))
PLATE = Surface(Material.PLAIN, (0.80, 0.80, 0.76))

#: Stations along a car from tail to nose: x, half width, belt height, half width and height of the
#: top, m. Side glass lies between the belt and the top wherever the top is a roof.
_STATIONS = {
    "sedan": [
        (-2.24, 0.70, 0.62, 0.62, 0.72),
        (-2.18, 0.84, 0.82, 0.74, 0.93),
        (-1.55, 0.90, 0.93, 0.72, 1.00),
        (-0.85, 0.91, 0.94, 0.60, 1.39),
        (0.15, 0.91, 0.93, 0.62, 1.44),
        (1.02, 0.90, 0.91, 0.76, 0.97),
        (1.90, 0.87, 0.78, 0.70, 0.84),
        (2.20, 0.74, 0.60, 0.62, 0.66),
    ],
    "hatchback": [
        (-1.95, 0.74, 0.66, 0.66, 0.80),
        (-1.90, 0.85, 0.90, 0.72, 0.99),
        (-1.55, 0.88, 0.96, 0.60, 1.40),
        (-0.60, 0.89, 0.95, 0.62, 1.49),
        (0.25, 0.89, 0.94, 0.62, 1.46),
        (1.05, 0.88, 0.92, 0.74, 0.99),
        (1.70, 0.84, 0.78, 0.68, 0.84),
        (1.95, 0.72, 0.58, 0.60, 0.64),
    ],
    "van": [
        (-2.45, 0.88, 0.80, 0.84, 1.00),
        (-2.42, 0.94, 1.10, 0.84, 1.86),
        (-2.30, 0.96, 1.12, 0.82, 1.96),
        (-0.40, 0.97, 1.12, 0.82, 1.98),
        (1.05, 0.97, 1.10, 0.80, 1.93),
        (1.75, 0.95, 1.08, 0.84, 1.16),
        (2.30, 0.90, 0.86, 0.80, 0.98),
        (2.48, 0.82, 0.60, 0.74, 0.68),
    ],
}
KINDS = tuple(_STATIONS)

#: Usual car colors, linear RGB.
PAINTS: tuple[Color, ...] = (
    (0.72, 0.72, 0.72),
    (0.42, 0.43, 0.45),
    (0.10, 0.10, 0.11),
    (0.03, 0.03, 0.035),
    (0.45, 0.03, 0.03),
    (0.05, 0.10, 0.32),
    (0.12, 0.22, 0.36),
    (0.08, 0.17, 0.10),
    (0.55, 0.40, 0.10),
    (0.32, 0.30, 0.24),
)


def car(thing: int, kind: str, paint: Color, seed: float, *, warm: bool = False) -> Mesh:
    """A car of one of `KINDS`; `warm`: its engine runs or ran."""
    stations = np.array(_STATIONS[kind])
    mesh = Mesh()
    body = Surface(Material.PAINT, paint, seed=seed)
    hood = Surface(Material.HOOD if warm else Material.PAINT, paint, seed=seed)
    rings = _rings(stations)
    normals = _smooth_normals(rings)
    roof = stations[:, 4] > stations[:, 2] + 0.2
    groups: dict[int, tuple[Surface, list[Array], list[Array]]] = {}
    for i in range(len(stations) - 1):
        front = i >= len(stations) - 3
        for j in range(rings.shape[1] - 1):
            side_glass = j in (2, 6) and (roof[i] or roof[i + 1])
            screen = j in (3, 4, 5) and roof[i] != roof[i + 1]
            if kind == "van" and i < 3 and j in (2, 3, 4, 5, 6) and not (i == 0 and j == 4):
                side_glass = screen = False
            surface = GLASS if side_glass or screen else hood if front else body
            _, faces, turns = groups.setdefault(id(surface), (surface, [], []))
            faces.append(_patch(rings[i : i + 2, j : j + 2]))
            turns.append(_patch(normals[i : i + 2, j : j + 2]))
    for surface, faces, turns in groups.values():
        # Panes are flat, sheet metal is not.
        smooth = None if surface is GLASS else np.concatenate(turns)
        mesh.add(thing, surface, np.concatenate(faces), smooth)
    for ring, flip in ((rings[0], False), (rings[-1], True)):
        fan = np.stack([np.broadcast_to(ring.mean(axis=0), ring[1:].shape), ring[:-1], ring[1:]], 1)
        mesh.add(thing, body, fan[:, ::-1] if flip else fan)
    nose, tail = stations[-2], stations[1]
    mesh.box(thing, TRIM, (0, 0, 0.24), (stations[-1, 0] * 1.88, 1.5, 0.12), bottom=True)
    for side in (-1, 1):
        wide = nose[1] * 0.68
        mesh.box(thing, LAMP, (nose[0] + 0.12, side * wide, nose[2] - 0.08), (0.3, 0.34, 0.13))
        wide = tail[1] * 0.76
        mesh.box(thing, TAIL, (tail[0] - 0.01, side * wide, tail[2] - 0.06), (0.1, 0.24, 0.2))
        mirror = (stations[-4, 0] + 0.62, side * (nose[1] + 0.14), stations[-4, 2] + 0.08)
        mesh.box(thing, body, mirror, (0.12, 0.18, 0.13), bottom=True)
        for x in (stations[0, 0] * 0.62, stations[-1, 0] * 0.64):
            _wheel(mesh, thing, x, side * (nose[1] - 0.07), 0.33, side)
    for x in (stations[0, 0], stations[-1, 0]):
        mesh.box(thing, PLATE, (x, 0, 0.48), (0.03, 0.5, 0.11))
        mesh.box(thing, TRIM, (x * 0.995, 0, 0.34), (0.08, 1.3, 0.16))
    return mesh


def fire_truck(thing: int) -> Mesh:
    """A fire engine with cab, lockers, ladder and blue lights, 7.6 m long."""
    mesh = Mesh()
    red = Surface(Material.PAINT, (0.52, 0.015, 0.01))
    warm = Surface(Material.HOOD, (0.52, 0.015, 0.01))
    white = Surface(Material.PAINT, (0.75, 0.75, 0.72))
    yellow = Surface(Material.PAINT, (0.65, 0.60, 0.03))
    gray = Surface(Material.METAL, (0.38, 0.39, 0.40), seed=0.3)
    blue = Surface(Material.LIGHT, (0.02, 0.08, 0.75))
    mesh.box(thing, TRIM, (0, 0, 0.62), (7.4, 2.1, 0.4), bottom=True)
    mesh.box(thing, red, (-1.1, 0, 1.9), (5.3, 2.5, 2.2), bottom=True)
    mesh.box(thing, warm, (2.65, 0, 1.18), (2.2, 2.45, 0.86), bottom=True)
    mesh.box(thing, red, (2.55, 0, 2.62), (2.0, 2.40, 0.42))
    mesh.box(thing, GLASS, (2.65, 0, 2.01), (2.06, 2.36, 0.82))
    for x in (1.62, 2.62):
        for side in (-1, 1):
            mesh.box(thing, red, (x, side * 1.17, 2.0), (0.16, 0.07, 0.84))
    mesh.box(thing, white, (0.0, 0, 1.05), (7.52, 2.53, 0.16))
    mesh.box(thing, yellow, (0.0, 0, 1.22), (7.52, 2.53, 0.1))
    for x in (-3.0, -1.9, -0.8, 0.3):  # locker shutters
        for side in (-1, 1):
            mesh.box(thing, gray, (x, side * 1.255, 2.05), (0.95, 0.03, 1.35))
    for side in (-1, 1):
        mesh.box(thing, blue, (2.9, side * 0.75, 2.94), (0.4, 0.5, 0.22))
        mesh.box(thing, LAMP, (3.77, side * 0.9, 1.1), (0.06, 0.36, 0.24))
        mesh.box(thing, TAIL, (-3.77, side * 1.05, 1.3), (0.06, 0.2, 0.4))
        for x in (-2.2, 2.45):
            _wheel(mesh, thing, x, side * 1.1, 0.5, side)
        rail = [(-3.6, side * 0.28, 3.22), (2.0, side * 0.28, 3.30)]
        mesh.tube(thing, gray, rail, 0.05, sides=6)
    for x in np.arange(-3.4, 1.9, 0.36):
        mesh.tube(thing, gray, [(x, -0.28, 3.26), (x, 0.28, 3.26)], 0.025, sides=5)
    return mesh


def _rings(stations: Array) -> Array:
    """Cross sections (stations, 10, 3) from the right sill over the top to the left sill."""
    x, belt_y, belt_z, top_y, top_z = stations.T
    half = [
        (belt_y * 0.95, np.full_like(x, 0.22)),
        (belt_y, np.full_like(x, 0.46)),
        (belt_y * 0.985, belt_z),
        (top_y, top_z - 0.06),
        (top_y * 0.62, top_z),
    ]
    right = [np.column_stack([x, -y, z]) for y, z in half]
    left = [np.column_stack([x, y, z]) for y, z in reversed(half)]
    return np.stack(right + left, axis=1)


def _smooth_normals(rings: Array) -> Array:
    """Unit normals (stations, 10, 3) of the skin over the rings."""
    normals = np.cross(np.gradient(rings, axis=1), np.gradient(rings, axis=0))
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.asarray(normals / np.maximum(length, 1e-9))


def _patch(corner: Array) -> Array:
    """Two triangles over the corners (2, 2, 3) of neighboring stations and ring points."""
    (a, b), (c, d) = corner
    return np.array([[a, c, d], [a, d, b]])


def _wheel(mesh: Mesh, thing: int, x: float, y: float, radius: float, side: int) -> None:
    mesh.tube(thing, TRIM, [(x, y - 0.11, radius), (x, y + 0.11, radius)], radius, sides=16)
    hub = [(x, y + side * 0.105, radius), (x, y + side * 0.12, radius)]
    mesh.tube(thing, HUB, hub, radius * 0.62, sides=10)
