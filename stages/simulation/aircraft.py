"""The vehicle itself: what its own LiDAR sees of it, and the shadow that it throws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stages.simulation.materials import Material
from stages.simulation.mesh import Array, Mesh, Surface
from stages.simulation.trajectory import Flight


@dataclass(frozen=True, slots=True, eq=False)
class Aircraft:
    """A quadrotor on two legs, as an actor that flies the flight."""

    parts: Sequence[Mesh]
    flight: Flight

    def poses(self, time_s: float) -> Array:
        return self.flight.at(np.array([round(time_s * 1e9)]))


def aircraft(thing: int) -> Mesh:
    """Body, arms, rotors and legs in the base frame, 0.9 m between the rotors."""
    mesh = Mesh()
    shell = Surface(Material.PLAIN, (0.10, 0.10, 0.11))
    carbon = Surface(Material.PLAIN, (0.03, 0.03, 0.03))
    mesh.box(thing, shell, (0.0, 0.0, 0.06), (0.34, 0.24, 0.14), bottom=True)
    for x, y in ((0.32, 0.32), (0.32, -0.32), (-0.32, 0.32), (-0.32, -0.32)):
        mesh.tube(thing, carbon, [(x * 0.3, y * 0.3, 0.1), (x, y, 0.13)], 0.018, sides=6)
        mesh.tube(thing, carbon, [(x, y, 0.10), (x, y, 0.18)], 0.03, sides=8)
        # A turning rotor is half transparent: two blades stand for the disc.
        mesh.box(thing, carbon, (x, y, 0.19), (0.40, 0.03, 0.006), yaw=1.1 * x - y, bottom=True)
    for side in (-1, 1):
        foot = (-0.05, side * 0.30, -0.36)
        mesh.tube(thing, carbon, [(-0.05, side * 0.10, 0.0), foot], 0.014, sides=6)
        skid = [(-0.28, side * 0.30, -0.36), (0.16, side * 0.30, -0.36)]
        mesh.tube(thing, carbon, skid, 0.014, sides=6)
    return mesh
