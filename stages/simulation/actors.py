"""What moves: walking persons, driving cars, cyclists, and the operator behind the vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from stages.simulation.bicycles import bicycle
from stages.simulation.mesh import Array, Color, Mesh, standing
from stages.simulation.persons import Build, limbs, riding, walking
from stages.simulation.streets import KERB_M, ROAD_M, Grid
from stages.simulation.things import Things
from stages.simulation.trajectory import Flight
from stages.simulation.vehicles import PAINTS, car

VEST: Color = (0.80, 0.26, 0.01)  #: signal orange


class Actor(Protocol):
    """Something rigid or jointed that moves."""

    @property
    def parts(self) -> Sequence[Mesh]: ...

    def poses(self, time_s: float) -> Array:
        """map_from_part (parts, 4, 4) at a time."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Walker:
    """A person who walks to and fro on a line."""

    parts: Sequence[Mesh]
    build: Build
    start: Array  #: (2,) m
    stop: Array
    speed_m_s: float
    phase: float  #: 0..1 of the way there and back, at time 0
    grid: Grid

    def poses(self, time_s: float) -> Array:
        length = float(np.linalg.norm(self.stop - self.start))
        turn = (self.phase + time_s * self.speed_m_s / (2 * length)) % 1.0
        back = turn > 0.5
        part = 2 * (1 - turn) if back else 2 * turn
        x, y = self.start + part * (self.stop - self.start)
        dx, dy = (self.start - self.stop) if back else (self.stop - self.start)
        # Two steps of 0.72 m per turn of the gait.
        gait = 2 * np.pi * time_s * self.speed_m_s / (0.83 * self.build.height_m)
        ground = ground_height(self.grid, x, y)
        body = standing(x, y, float(np.arctan2(dy, dx)), ground)
        return np.asarray(body @ walking(self.build, gait + 7.0 * self.phase))


@dataclass(frozen=True, slots=True, eq=False)
class Operator:
    """The person who flies the vehicle: follows it on foot, always behind it."""

    parts: Sequence[Mesh]
    build: Build
    flight: Flight
    grid: Grid
    behind_s: float = 2.6
    aside_m: float = 1.0

    def poses(self, time_s: float) -> Array:
        nanoseconds = np.array([time_s - self.behind_s, time_s - self.behind_s + 0.5]) * 1e9
        # Before the flight's first pose the operator stands where it leads back to.
        first = self.flight.stamps[0]
        early = np.minimum(nanoseconds - first, 0.0) / 1e9
        times = np.maximum(nanoseconds, first).astype(np.int64)
        here, soon = self.flight.at(times)[:, :2, 3]
        way = soon - here
        speed = float(np.linalg.norm(way)) * 2
        heading = way / max(float(np.linalg.norm(way)), 1e-6)
        x, y = (
            here + heading * early[0] * speed + self.aside_m * np.array([-heading[1], heading[0]])
        )
        gait = 2 * np.pi * time_s * speed / (0.83 * self.build.height_m)
        body = standing(
            x, y, float(np.arctan2(heading[1], heading[0])), ground_height(self.grid, x, y)
        )
        return np.asarray(body @ walking(self.build, gait, min(1.0, speed)))


@dataclass(frozen=True, slots=True, eq=False)
class Driver:
    """A car that drives along a street for ever, from one end of it to the other."""

    parts: Sequence[Mesh]
    start: Array  #: (2,) m
    stop: Array
    speed_m_s: float
    phase: float  #: 0..1 of the way at time 0

    def pose(self, time_s: float) -> Array:
        length = float(np.linalg.norm(self.stop - self.start))
        part = (self.phase + time_s * self.speed_m_s / length) % 1.0
        x, y = self.start + part * (self.stop - self.start)
        dx, dy = self.stop - self.start
        return standing(x, y, float(np.arctan2(dy, dx)))

    def poses(self, time_s: float) -> Array:
        return self.pose(time_s)[None]


@dataclass(frozen=True, slots=True, eq=False)
class Cyclist:
    """A person on a bicycle: the rider's limbs, and last the bicycle."""

    parts: Sequence[Mesh]
    build: Build
    ride: Driver

    def poses(self, time_s: float) -> Array:
        pose = self.ride.pose(time_s)
        saddle = standing(-0.26, 0.0)
        pedals = 2 * np.pi * 1.1 * time_s + 5.0 * self.ride.phase
        return np.concatenate([pose @ saddle @ riding(self.build, pedals), pose[None]])


@dataclass(frozen=True, slots=True, eq=False)
class Cast:
    """All actors."""

    actors: list[Actor] = field(default_factory=list)

    @property
    def parts(self) -> list[Mesh]:
        """The meshes of all parts, in the order of `poses`."""
        return [part for actor in self.actors for part in actor.parts]

    def poses(self, time_s: float) -> Array:
        """map_from_part (parts, 4, 4) of all at a time."""
        if not self.actors:
            return np.zeros((0, 4, 4))
        return np.concatenate([actor.poses(time_s) for actor in self.actors])


def new_walker(
    things: Things,
    random: np.random.Generator,
    grid: Grid,
    start: Array,
    stop: Array,
    phase: float | None = None,
) -> Walker:
    """A person at random on a line."""
    build = Build.draw(random)
    speed = float(random.uniform(1.0, 1.6))
    at = float(random.random()) if phase is None else phase
    return Walker(limbs(things.new("person"), build), build, start, stop, speed, at, grid)


def new_operator(
    things: Things, random: np.random.Generator, grid: Grid, flight: Flight
) -> Operator:
    """The operator, in a signal-orange vest."""
    build = Build.draw(random, shirt=VEST)
    return Operator(limbs(things.new("person"), build), build, flight, grid)


def new_driver(
    things: Things, random: np.random.Generator, ride: tuple[Array, Array], kind: str, paint: int
) -> Driver:
    """A driving car; its engine is warm."""
    mesh = car(things.new("vehicle"), kind, PAINTS[paint], float(random.random()), warm=True)
    return Driver([mesh], *ride, float(random.uniform(5.0, 9.0)), float(random.random()))


def new_cyclist(
    things: Things, random: np.random.Generator, ride: tuple[Array, Array], phase: float
) -> Cyclist:
    """A person riding a bicycle."""
    build = Build.draw(random)
    color = tuple(random.uniform(0.03, 0.5, 3))
    parts = [*limbs(things.new("rider"), build), bicycle(things.new("bicycle"), color)]
    driver = Driver([], *ride, float(random.uniform(3.0, 4.5)), phase)
    return Cyclist(parts, build, driver)


def ground_height(grid: Grid, x: float, y: float) -> float:
    """Height of the ground at a point: a street's, or the raised ground of a block."""
    half = ROAD_M / 2
    on_street = (np.abs(grid.xs - x) < half).any() or (np.abs(grid.ys - y) < half).any()
    return 0.0 if on_street else KERB_M
