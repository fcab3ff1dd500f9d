"""Persons: rigid limbs, and where each is while they stand, walk or ride."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stages.simulation.materials import Material
from stages.simulation.mesh import Array, Color, Mesh, Surface

#: Limbs in the order of the parts: the trunk with the head, then thigh, shin, upper arm and
#: forearm of the right and of the left side. Each hangs down from its joint at the origin.
PARTS = 9

_SKINS: tuple[Color, ...] = ((0.58, 0.38, 0.28), (0.45, 0.28, 0.19), (0.20, 0.11, 0.07))
_CLOTHES: tuple[Color, ...] = (
    (0.55, 0.05, 0.05),
    (0.04, 0.09, 0.30),
    (0.60, 0.60, 0.58),
    (0.05, 0.22, 0.12),
    (0.03, 0.03, 0.04),
    (0.62, 0.42, 0.05),
    (0.30, 0.22, 0.16),
    (0.15, 0.30, 0.45),
    (0.65, 0.20, 0.02),
)
_TROUSERS: tuple[Color, ...] = (
    (0.03, 0.04, 0.09),
    (0.02, 0.02, 0.02),
    (0.22, 0.20, 0.16),
    (0.08, 0.09, 0.10),
)
_HAIRS: tuple[Color, ...] = ((0.03, 0.02, 0.015), (0.10, 0.05, 0.02), (0.35, 0.25, 0.10))


@dataclass(frozen=True, slots=True)
class Build:
    """One person's size and looks."""

    height_m: float
    shirt: Color
    trousers: Color
    skin: Color
    hair: Color

    @classmethod
    def draw(cls, random: np.random.Generator, shirt: Color | None = None) -> Build:
        """A person at random; a `shirt` may be asked for."""
        return cls(
            float(np.clip(random.normal(1.73, 0.09), 1.5, 1.95)),
            shirt or _CLOTHES[random.integers(len(_CLOTHES))],
            _TROUSERS[random.integers(len(_TROUSERS))],
            _SKINS[random.integers(len(_SKINS))],
            _HAIRS[random.integers(len(_HAIRS))],
        )

    @property
    def hip_m(self) -> float:
        """Height of the hip joints."""
        return 0.53 * self.height_m


def limbs(thing: int, build: Build) -> list[Mesh]:
    """The `PARTS` meshes of a person."""
    h = build.height_m / 1.75
    shirt = Surface(Material.CLOTH, build.shirt)
    trousers = Surface(Material.CLOTH, build.trousers)
    skin = Surface(Material.SKIN, build.skin)
    hair = Surface(Material.HAIR, build.hair)
    shoe = Surface(Material.RUBBER, (0.04, 0.035, 0.03))
    trunk = Mesh()
    trunk.ellipsoid(thing, trousers, (0, 0, 0.02 * h), (0.115 * h, 0.165 * h, 0.13 * h))
    trunk.ellipsoid(thing, shirt, (0, 0, 0.20 * h), (0.115 * h, 0.16 * h, 0.22 * h))
    trunk.ellipsoid(thing, shirt, (0, 0, 0.37 * h), (0.12 * h, 0.20 * h, 0.20 * h), 12, 9)
    trunk.tube(thing, skin, [(0, 0, 0.5 * h), (0.01, 0, 0.62 * h)], 0.055 * h)
    trunk.ellipsoid(thing, skin, (0.03 * h, 0, 0.71 * h), (0.095 * h, 0.078 * h, 0.118 * h), 12, 9)
    trunk.ellipsoid(
        thing, hair, (0.005 * h, 0, 0.742 * h), (0.103 * h, 0.086 * h, 0.105 * h), 12, 9
    )
    parts = [trunk]
    for _side in (-1, 1):
        thigh, shin, upper, fore = Mesh(), Mesh(), Mesh(), Mesh()
        thigh.tube(thing, trousers, _bone(0.45 * h), _taper(0.088 * h, 0.062 * h))
        shin.tube(thing, trousers, _bone(0.43 * h), _taper(0.062 * h, 0.045 * h))
        shin.ellipsoid(thing, shoe, (0.06 * h, 0, -0.445 * h), (0.135 * h, 0.05 * h, 0.045 * h))
        upper.tube(thing, shirt, _bone(0.29 * h), _taper(0.055 * h, 0.043 * h))
        fore.tube(thing, shirt, _bone(0.20 * h), _taper(0.042 * h, 0.036 * h))
        fore.tube(thing, skin, [(0, 0, -0.19 * h), (0, 0, -0.25 * h)], 0.032 * h)
        fore.ellipsoid(thing, skin, (0, 0, -0.30 * h), (0.042 * h, 0.03 * h, 0.06 * h), 8, 5)
        parts += [thigh, shin, upper, fore]
    return parts


def walking(build: Build, phase: float, stride: float = 1.0) -> Array:
    """Poses (PARTS, 4, 4) of the limbs over the feet's middle; `phase` runs 2 pi per two steps.

    `stride` 0 is standing. Hip and knee swing as sines: about what gait laboratories report
    (hip +-25 deg, knee up to 60 deg in the swing).
    """
    swing = np.sin(phase + np.array([0.0, np.pi]))
    lift = np.maximum(0.0, np.cos(phase + np.array([0.0, np.pi])))
    hips = np.radians(25.0) * stride * swing
    knees = np.radians(8.0 + 52.0 * stride * lift)
    arms = -np.radians(22.0) * stride * swing
    elbows = -np.radians(12.0 + 16.0 * stride)
    lower = 0.02 * stride * (1.0 - np.cos(2 * phase))
    return _pose(build, build.hip_m - lower, 0.03, hips, knees, arms, np.full(2, elbows))


def lying(build: Build, random: np.random.Generator) -> Array:
    """Poses (PARTS, 4, 4) of the limbs of a person who lies on the back, the head toward -x, arms
    and legs at random; the hip is over the origin."""
    hips, arms = random.uniform(0.0, 0.6, 2), -random.uniform(0.0, 0.2, 2)
    knees, elbows = 2 * hips, -random.uniform(0.0, 0.5, 2)  # a drawn-up leg has its foot down
    upright = _pose(build, 0.0, 0.0, hips, knees, arms, elbows)
    down = np.eye(4)
    down[:3, :3] = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]  # up becomes backward, ahead becomes up
    down[2, 3] = 0.13 * build.height_m / 1.75  # as deep as a trunk is
    return np.asarray(down @ upright)


def riding(build: Build, phase: float) -> Array:
    """Poses (PARTS, 4, 4) of the limbs on a bicycle's saddle; `phase` turns the pedals."""
    turn = np.sin(phase + np.array([0.0, np.pi]))
    hips = np.radians(62.0 + 20.0 * turn)
    knees = np.radians(80.0 + 22.0 * turn)
    return _pose(build, 0.99, 0.6, hips, knees, np.full(2, -0.95), np.full(2, -0.25))


def _pose(
    build: Build, hip_z: float, lean: float, hips: Array, knees: Array, arms: Array, elbows: Array
) -> Array:
    h = build.height_m / 1.75
    trunk = _joint(lean, (0.0, 0.0, hip_z))
    poses = [trunk]
    for i, side in enumerate((-1, 1)):
        thigh = _joint(-hips[i], (0.0, side * 0.095 * h, hip_z))
        shin = thigh @ _joint(knees[i], (0.0, 0.0, -0.45 * h))
        shoulder = trunk @ np.array([0.0, side * 0.215 * h, 0.46 * h, 1.0])
        upper = _joint(arms[i], tuple(shoulder[:3])) @ _roll(side * 0.10)
        fore = upper @ _joint(elbows[i], (0.0, 0.0, -0.29 * h))
        poses += [thigh, shin, upper, fore]
    return np.stack(poses)


def _joint(pitch: float, at: tuple[float, ...]) -> Array:
    """A turn about y (positive: a hanging limb swings backward) at a point."""
    c, s = math.cos(pitch), math.sin(pitch)
    x, y, z = at
    return np.array([[c, 0, s, x], [0, 1, 0, y], [-s, 0, c, z], [0, 0, 0, 1]], dtype=np.float64)


def _roll(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]], dtype=np.float64)


def _bone(length: float) -> list[tuple[float, float, float]]:
    return [(0, 0, 0.03), (0, 0, 0), (0, 0, -length / 2), (0, 0, -length)]


def _taper(thick: float, thin: float) -> tuple[float, float, float, float]:
    return (thick * 0.6, thick, (thick + thin) / 2, thin)
