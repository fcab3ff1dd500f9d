"""The flight: a route through the streets, flown smoothly, and the pose at any instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.kernels.geometry import interpolate_poses
from stages.simulation.mesh import Array
from stages.simulation.streets import Grid

#: Spacing of the poses that the flight is made of; between them it is interpolated. At 2 m/s2 a
#: straight line between two is off by 2 * 0.005^2 / 8 = 6 um.
STEP_S = 0.005
GRAVITY = 9.81
SMOOTH_S = 0.9  #: how far turns and speed changes are spread out in time


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A polyline along the middles of streets, and the part of it that is flown."""

    points: Array  #: (k, 2) m
    length_m: float  #: flown from the first point

    def at(self, distance_m: Array | float) -> tuple[Array, Array]:
        """Points (n, 2) and unit directions (n, 2) at distances along; beyond the ends straight
        on."""
        legs = np.diff(self.points, axis=0)
        lengths = np.linalg.norm(legs, axis=1)
        directions = legs / lengths[:, None]
        ends = np.concatenate([[0.0], np.cumsum(lengths)])
        along = np.atleast_1d(np.asarray(distance_m, dtype=np.float64))
        leg = np.clip(np.searchsorted(ends, along, side="right") - 1, 0, len(legs) - 1)
        points = self.points[leg] + (along - ends[leg])[:, None] * directions[leg]
        return points, directions[leg]

    @classmethod
    def draw(cls, random: np.random.Generator, grid: Grid, length_m: float) -> Route:
        """A route of `length_m` that begins 18 to 26 m before a crossing in the district's middle
        and turns at most crossings, never back, never to the rim."""
        node = np.array([len(grid.xs) // 2, len(grid.ys) // 2])
        heading = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])[random.integers(4)]
        sizes = np.array([len(grid.xs), len(grid.ys)])

        def place(at: NDArray[np.int64]) -> Array:
            return np.array([grid.xs[at[0]], grid.ys[at[1]]])

        points = [place(node) - heading * random.uniform(18.0, 26.0), place(node)]
        total = float(np.linalg.norm(points[1] - points[0]))
        while total < length_m + 60.0:
            left = np.array([-heading[1], heading[0]])
            turns = [left, -left, heading]
            turns = [turns[k] for k in random.permutation(3)]
            inside = [
                turn for turn in turns if ((node + turn >= 1) & (node + turn <= sizes - 2)).all()
            ]
            heading = inside[0]
            node = node + heading
            points.append(place(node))
            total += float(np.linalg.norm(points[-1] - points[-2]))
        return cls(np.array(points), length_m)


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """The vehicle's true motion; times are ns from the flight's start."""

    stamps: NDArray[np.int64]  #: (n,)
    map_from_base: NDArray[np.float64]  #: (n, 4, 4)

    def at(self, times: NDArray[np.int64]) -> NDArray[np.float64]:
        """Poses (k, 4, 4)."""
        return interpolate_poses(self.stamps, self.map_from_base, times)[0]

    @classmethod
    def fly(
        cls,
        random: np.random.Generator,
        route: Route,
        duration_s: float,
        speed_m_s: float,
        height_m: tuple[float, float],
    ) -> Flight:
        """Along the route at about `speed_m_s` and between two heights: banked into its own
        acceleration, with the wobble of wind and a slow look to the sides."""
        margin = 2.0
        time = np.arange(-margin, duration_s + margin, STEP_S)
        speed = speed_m_s * (1.0 + 0.18 * _waves(random, time, 0.05, 0.2))
        speed = np.maximum(speed, 0.1 * speed_m_s)
        along = np.cumsum(speed) * STEP_S
        along -= np.interp(0.0, time, along)
        points, directions = route.at(along)
        left = np.column_stack([-directions[:, 1], directions[:, 0]])
        points = _smooth(points + left * (1.2 * _waves(random, time, 0.03, 0.12))[:, None])
        low, high = height_m
        height = (low + high) / 2 + (high - low) / 2 * np.tanh(_waves(random, time, 0.02, 0.08))
        position = np.column_stack([points, _smooth(height[:, None])[:, 0]])
        acceleration = np.gradient(np.gradient(position, STEP_S, axis=0), STEP_S, axis=0)
        heading = np.unwrap(np.arctan2(directions[:, 1], directions[:, 0]))
        yaw = _smooth(heading[:, None])[:, 0] + 0.28 * _waves(random, time, 0.03, 0.10)
        ahead = acceleration[:, 0] * np.cos(yaw) + acceleration[:, 1] * np.sin(yaw)
        aside = -acceleration[:, 0] * np.sin(yaw) + acceleration[:, 1] * np.cos(yaw)
        # Nose down to fly forward against the drag, and to speed up; the sway of wind on top.
        pitch = 0.012 * speed + ahead / GRAVITY + 0.016 * _waves(random, time, 0.3, 1.6)
        roll = -aside / GRAVITY + 0.016 * _waves(random, time, 0.3, 1.6)
        poses = np.zeros((len(time), 4, 4))
        poses[:, :3, :3] = _rotations(roll, pitch, yaw)
        poses[:, :3, 3] = position
        poses[:, 3, 3] = 1.0
        return cls(np.round(time * 1e9).astype(np.int64), poses)


def _waves(random: np.random.Generator, time: Array, low_hz: float, high_hz: float) -> Array:
    """A smooth random signal (n,) of about unit amplitude: five sines of random phase."""
    rates = random.uniform(low_hz, high_hz, 5)
    phases = random.uniform(0, 2 * np.pi, 5)
    return np.asarray(np.sin(2 * np.pi * rates * time[:, None] + phases).sum(axis=1) / 2.2)


def _smooth(values: Array) -> Array:
    """Columns (n, k) convolved with a Gaussian of `SMOOTH_S`, their ends continued straight."""
    reach = round(5 * SMOOTH_S / STEP_S)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * STEP_S / SMOOTH_S) ** 2)
    kernel /= kernel.sum()
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    columns = [np.convolve(column, kernel, mode="valid") for column in padded.T]
    return np.column_stack(columns)


def _rotations(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Rotation matrices (n, 3, 3): yaw about z after pitch about y after roll about x."""
    (sr, sp, sy), (cr, cp, cy) = (
        (np.sin(roll), np.sin(pitch), np.sin(yaw)),
        (np.cos(roll), np.cos(pitch), np.cos(yaw)),
    )
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
