"""Bicycles; each faces +x with its wheels on z = 0."""

from __future__ import annotations

import numpy as np

from stages.simulation.materials import Material
from stages.simulation.mesh import Array, Color, Mesh, Surface

_TIRE = Surface(Material.RUBBER, (0.03, 0.03, 0.03))
_STEEL = Surface(Material.METAL, (0.5, 0.5, 0.52))
_WHEEL_M = 0.34
_BASE_M = 1.06  #: between the axles


def bicycle(thing: int, color: Color) -> Mesh:
    """A city bicycle with basket and mudguards, 1.75 m long."""
    mesh = Mesh()
    paint = Surface(Material.PAINT, color)
    back = np.array([-_BASE_M / 2, 0.0, _WHEEL_M])
    front = np.array([_BASE_M / 2, 0.0, _WHEEL_M])
    for axle in (back, front):
        mesh.tube(thing, _TIRE, _arc(axle, _WHEEL_M - 0.02, 0, 2 * np.pi, 25), 0.026, sides=6)
        mesh.tube(thing, paint, _arc(axle, _WHEEL_M + 0.03, 0.3, 2.6, 9), 0.026, sides=4)
        for angle in np.linspace(0, np.pi, 8, endpoint=False):
            spoke = (_WHEEL_M - 0.03) * np.array([np.cos(angle), 0, np.sin(angle)])
            mesh.tube(thing, _STEEL, [axle - spoke, axle + spoke], 0.004, sides=3)
    crank = np.array([-0.08, 0.0, 0.29])
    saddle = np.array([-0.26, 0.0, 0.92])
    head = np.array([0.37, 0.0, 0.86])
    fork = np.array([0.42, 0.0, 0.66])
    grip = np.array([0.28, 0.0, 1.06])
    for path, radius in (
        ([crank, saddle], 0.022),
        ([crank, fork], 0.026),
        ([saddle * [1, 1, 0.86], head * [1, 1, 0.92]], 0.022),
        ([crank, back], 0.016),
        ([back, saddle * [1, 1, 0.86]], 0.014),
        ([head, fork, front], 0.022),
        ([head, grip], 0.018),
    ):
        mesh.tube(thing, paint, path, radius, sides=6)
    bar = [(0.18, -0.30, 1.04), (0.30, 0.0, 1.06), (0.18, 0.30, 1.04)]
    mesh.tube(thing, _STEEL, bar, 0.016, sides=6)
    mesh.ellipsoid(thing, _TIRE, (-0.26, 0.0, 0.96), (0.14, 0.08, 0.04), 8, 5)
    mesh.tube(thing, _STEEL, [(-0.08, -0.13, 0.42), (-0.08, 0.13, 0.16)], 0.016, sides=5)
    basket = Surface(Material.METAL, (0.12, 0.12, 0.13))
    mesh.box(thing, basket, (0.52, 0, 0.98), (0.26, 0.34, 0.22), bottom=True)
    mesh.box(thing, _STEEL, (-0.55, 0, 0.74), (0.36, 0.14, 0.03), bottom=True)
    return mesh


def _arc(center: Array, radius: float, start: float, stop: float, points: int) -> Array:
    """Points (points, 3) of an arc in the x-z plane."""
    angle = np.linspace(start, stop, points)
    zero = np.zeros(points)
    return np.asarray(center + radius * np.column_stack([np.cos(angle), zero, np.sin(angle)]))
