"""A district from a seed: streets, houses, plants, furniture, vehicles and people near the route.

Everything of the small classes (persons, bicycles, cars) stands near the route, so that a short
flight sees enough of each.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stages.simulation import furniture, plants
from stages.simulation.actors import (
    VEST,
    Cast,
    ground_height,
    new_cyclist,
    new_driver,
    new_operator,
    new_walker,
)
from stages.simulation.aircraft import Aircraft, aircraft
from stages.simulation.bicycles import bicycle
from stages.simulation.buildings import house
from stages.simulation.materials import Material
from stages.simulation.mesh import Array, Color, Mesh, Surface, standing, turned
from stages.simulation.persons import Build, limbs, lying, walking
from stages.simulation.ruins import rubble, ruin
from stages.simulation.scene import Model
from stages.simulation.streets import (
    KERB_M,
    ROAD_M,
    SIDEWALK_M,
    Block,
    Grid,
    lay_streets,
    pave_block,
)
from stages.simulation.things import Things
from stages.simulation.trace import Scene
from stages.simulation.trajectory import Flight, Route
from stages.simulation.vehicles import KINDS, PAINTS, car, fire_truck

BLOCKS = 6  #: per side
NEAR_M = 90.0  #: detail (plants, cars, furniture) is placed this near to the route
RUINED = 0.45  #: share of the houses along the route of a disaster site

_LAWN = Surface(Material.LAWN, (0.105, 0.165, 0.04))
_YARD = Surface(Material.GRAVEL, (0.33, 0.30, 0.25))
_BINS: tuple[Color, ...] = ((0.05, 0.12, 0.05), (0.03, 0.03, 0.035), (0.04, 0.08, 0.22))


@dataclass(frozen=True, slots=True, eq=False)
class District:
    """A district with its actors and the flight through it."""

    model: Model
    still: Mesh
    classes: NDArray[np.uint8]  #: (things,) class of each thing
    cast: Cast
    flight: Flight
    sun: NDArray[np.float32]  #: (3,) unit vector toward the sun

    def at(self, time_ns: int) -> Scene:
        """The scene at a time of the flight."""
        return self.model.at(self.cast.poses(time_ns / 1e9))


def build_district(
    seed: int,
    duration_s: float,
    speed_m_s: float,
    height_m: tuple[float, float],
    body: str,
    site: str = "district",
) -> District:
    """The district, actors and flight of a seed; the vehicle's `body` is an aircraft or none, the
    `site` a district or, after a disaster, what is left of it."""
    random = np.random.default_rng([seed, 0xD157])
    grid = Grid.draw(random, BLOCKS)
    route = Route.draw(random, grid, duration_s * speed_m_s * 1.1)
    flight = Flight.fly(random, route, duration_s, speed_m_s, height_m)
    builder = _Builder(random, grid, route, wrecked=site == "disaster")
    builder.blocks()
    builder.parked_cars()
    builder.sidewalks()
    builder.along_the_route()
    cast = builder.cast(flight, operated=body == "aircraft")
    if body == "aircraft":
        own = builder.things.new("background")
        cast.actors.append(Aircraft([aircraft(own)], flight))
    azimuth, height = random.uniform(0, 2 * np.pi), random.uniform(0.6, 0.95)
    sun = [np.cos(azimuth) * np.cos(height), np.sin(azimuth) * np.cos(height), np.sin(height)]
    return District(
        Model.of(builder.still, cast.parts),
        builder.still,
        builder.things.table(),
        cast,
        flight,
        np.array(sun, dtype=np.float32),
    )


class _Builder:
    """The district while it grows."""

    def __init__(
        self, random: np.random.Generator, grid: Grid, route: Route, *, wrecked: bool = False
    ) -> None:
        self.random = random
        self.wrecked = wrecked
        self.grid = grid
        self.route = route
        self.still = Mesh()
        self.things = Things()
        self._track = route.at(np.arange(-15.0, route.length_m + 30.0, 2.0))[0]
        self._taken: list[tuple[float, float, float]] = []  # x, y, radius
        lay_streets(self.still, self.things, grid)

    def put(self, mesh: Mesh, x: float, y: float, yaw: float = 0.0) -> None:
        """Insert a mesh, standing on the ground."""
        self.still.insert(mesh, standing(x, y, yaw, ground_height(self.grid, x, y)))

    def near(self, x: float, y: float) -> float:
        """Distance of a point from the route, m."""
        return float(np.hypot(*(self._track - (x, y)).T).min())

    def free(self, x: float, y: float, radius: float) -> bool:
        """Take a place; False where something stands already."""
        if any(np.hypot(x - u, y - v) < radius + r for u, v, r in self._taken):
            return False
        self._taken.append((x, y, radius))
        return True

    def blocks(self) -> None:
        """What the blocks between the streets are."""
        for block in self.grid.blocks():
            draw = self.random.random()
            if draw < 0.70:
                pave_block(self.still, self.things, block, _LAWN, "vegetation")
                self._houses(block)
            elif draw < 0.88:
                pave_block(self.still, self.things, block, _LAWN, "vegetation")
                self._park(block)
            else:
                pave_block(self.still, self.things, block, _YARD, "sidewalk")
                self._houses(block)

    def _houses(self, block: Block) -> None:
        """Houses along all four sides, their fronts to the street."""
        random = self.random
        for k in range(4):
            corner, along, length = block.side(k)
            inward = turned(along[None], np.pi / 2)[0]
            depth, setback = random.uniform(9.0, 11.0), random.uniform(2.2, 4.5)
            front = SIDEWALK_M + setback
            # East and west sides leave the corners to the south and north ones.
            corner_m = 19.0 if k % 2 else SIDEWALK_M + 1.0
            at, row = corner_m, bool(random.random() < 0.35)
            while True:
                width = random.uniform(9.0, 14.0)
                if at + width > length - corner_m:
                    break
                middle = corner + along * (at + width / 2)
                x, y = middle + inward * (front + depth / 2)
                yaw = k * np.pi / 2
                floors = int(random.integers(2, 5))
                self.put(self._building(middle, width, depth, floors), x, y, yaw)
                if self.near(*middle) < NEAR_M:
                    self._front_garden(middle + inward * SIDEWALK_M, along, inward, width, setback)
                    rear = middle + inward * (front + depth + random.uniform(2.5, 4.0))
                    if random.random() < 0.6:
                        self._tree(rear[0], rear[1], conifers=0.3)
                at += width + (0.05 if row else random.uniform(2.0, 5.0))

    def _building(self, front: Array, width: float, depth: float, floors: int) -> Mesh:
        """A house, or after a disaster near the route often a ruin."""
        thing = self.things.new("building")
        if self.wrecked and self.near(*front) < NEAR_M / 2 and self.random.random() < RUINED:
            return ruin(thing, self.things.new("object"), self.random, width, depth, floors)
        return house(thing, self.random, width, depth, floors)

    def _front_garden(
        self, edge: Array, along: Array, inward: Array, width: float, setback: float
    ) -> None:
        """Hedge or fence at the sidewalk with a gap for the door, a bush, bins."""
        random = self.random
        yaw = float(np.arctan2(along[1], along[0]))
        draw = random.random()
        piece = width / 2 - 1.3
        wood: Color = (0.30, 0.20, 0.12) if random.random() < 0.5 else (0.62, 0.61, 0.58)
        for side in (-1, 1):
            x, y = edge + along * side * (1.0 + piece / 2) + inward * 0.35
            if draw < 0.45:
                height = random.uniform(0.8, 1.4)
                self.put(
                    plants.hedge(self.things.new("vegetation"), random, piece, height), x, y, yaw
                )
            elif draw < 0.75:
                self.put(furniture.fence(self.things.new("barrier"), piece, wood), x, y, yaw)
            if random.random() < 0.6:
                x, y = edge + along * side * random.uniform(1.6, width / 2) + inward * setback * 0.6
                size = random.uniform(0.4, 0.8)
                self.put(plants.bush(self.things.new("vegetation"), random, size), x, y)
        if random.random() < 0.4:
            for k in range(int(random.integers(1, 4))):
                x, y = edge + along * (1.4 + 0.7 * k) + inward * (setback - 0.6)
                color = _BINS[random.integers(len(_BINS))]
                self.put(furniture.bin_on_wheels(self.things.new("object"), color), x, y, yaw)

    def _park(self, block: Block) -> None:
        """Lawn with trees, a gravel path and benches."""
        random = self.random
        (x0, y0), (x1, y1) = block.low, block.high
        path = self.things.new("sidewalk")
        middle = (y0 + y1) / 2
        gravel = Surface(Material.GRAVEL, (0.38, 0.33, 0.25))
        z = KERB_M + 0.01
        inset = SIDEWALK_M
        ring = [(x0 + inset, middle - 1.3, z), (x1 - inset, middle - 1.3, z)]
        ring += [(x1 - inset, middle + 1.3, z), (x0 + inset, middle + 1.3, z)]
        self.still.quad(path, gravel, ring)
        for x in np.arange(x0 + 9.0, x1 - 8.0, 11.0):
            bench = furniture.bench(self.things.new("object"))
            self.put(bench, x, middle + 2.0)
        for _ in range(34):
            x, y = random.uniform(x0 + 4.5, x1 - 4.5), random.uniform(y0 + 4.5, y1 - 4.5)
            if abs(y - middle) > 3.5:
                self._tree(x, y, conifers=0.25)

    def _tree(self, x: float, y: float, conifers: float = 0.0) -> None:
        if self.near(x, y) < NEAR_M and self.free(x, y, 1.9):
            thing = self.things.new("vegetation")
            if self.random.random() < conifers:
                grown = plants.conifer(thing, self.random)
            else:
                grown = plants.tree(thing, self.random, fine=self.near(x, y) < 22.0)
            self.put(grown, x, y)

    def _street_sides(self) -> list[tuple[Array, Array, Array, float]]:
        """Every block side: its corner on the kerb, direction along, toward the street, length."""
        return [
            (corner, along, turned(along[None], -np.pi / 2)[0], length)
            for block in self.grid.blocks()
            for corner, along, length in (block.side(k) for k in range(4))
        ]

    def parked_cars(self) -> None:
        """A fire truck on the route, and cars in the parking lanes."""
        random = self.random
        self._fire_truck()
        for corner, along, outward, length in self._street_sides():
            at = 8.5
            while at < length - 8.5:
                x, y = corner + along * at + outward * 1.15
                near = self.near(x, y)
                wanted = 0.66 if near < 40 else 0.5
                if near < NEAR_M and random.random() < wanted and self.free(x, y, 2.3):
                    self._parked_car(x, y, float(np.arctan2(along[1], along[0])))
                at += random.uniform(5.4, 6.4)

    def _parked_car(self, x: float, y: float, yaw: float) -> None:
        random = self.random
        kind = KINDS[random.choice(len(KINDS), p=[0.42, 0.42, 0.16])]
        paint = PAINTS[random.integers(len(PAINTS))]
        warm = bool(random.random() < 0.15)
        mesh = car(self.things.new("vehicle"), kind, paint, random.random(), warm=warm)
        turn = random.normal(0, 0.02) + (np.pi if random.random() < 0.15 else 0.0)
        if self.wrecked:  # left in haste, or pushed aside
            turn += random.normal(0, 0.12)
        # Europe parks with the traffic: the kerb to the right.
        self.put(mesh, x, y, yaw + np.pi + turn)

    def _fire_truck(self) -> None:
        """In the parking lane, at the first place ahead that is clear of a crossing."""
        for distance in np.arange(30.0, 80.0, 2.0):
            (point,), (along,) = self.route.at(distance)
            x, y = point + turned(along[None], np.pi / 2)[0] * 2.9
            if self._off_crossings(x, y, 9.0):
                self._taken += _row(np.array([x, y]), along)
                yaw = float(np.arctan2(along[1], along[0]))
                self.put(fire_truck(self.things.new("vehicle")), x, y, yaw)
                return

    def _on_sidewalk(self, x: float, y: float) -> bool:
        return ground_height(self.grid, x, y) > 0.0

    def _off_crossings(self, x: float, y: float, margin: float) -> bool:
        """Whether a point lies at least `margin` beyond any crossing street."""
        reach = ROAD_M / 2 + margin
        return not (
            (np.abs(self.grid.xs - x) < reach).any() and (np.abs(self.grid.ys - y) < reach).any()
        )

    def sidewalks(self) -> None:
        """Street trees, lamps, signs and barriers along the kerbs near the route."""
        random = self.random
        for corner, along, outward, length in self._street_sides():
            yaw = float(np.arctan2(outward[1], outward[0]))
            trees = random.random() < 0.6
            for at in np.arange(6.0, length - 5.0, 7.5):
                x, y = corner + along * at - outward * 0.5
                if self.near(x, y) > NEAR_M:
                    continue
                draw = random.random()
                if trees and draw < 0.45:
                    self._tree(x, y)
                elif draw < 0.65:
                    self.put(furniture.street_lamp(self.things.new("object")), x, y, yaw)
                elif draw < 0.75:
                    turn = float(np.arctan2(along[1], along[0]))
                    self.put(furniture.sign(self.things.new("object"), random), x, y, turn)
            for at in (2.2, length - 2.2):
                x, y = corner + along * at - outward * 0.45
                if random.random() < 0.5 and self.near(x, y) < NEAR_M:
                    turn = float(np.arctan2(along[1], along[0]))
                    self.put(furniture.sign(self.things.new("object"), random), x, y, turn)

    def along_the_route(self) -> None:
        """Standing persons, bicycles and barriers on both sides of the route."""
        random = self.random
        kinds = ("bicycles", "group", "bicycles", "group", "barriers")
        if self.wrecked:
            kinds = ("rubble", "group", "barriers", "rubble", "group")
        for k, distance in enumerate(np.arange(-6.0, self.route.length_m + 26.0, 5.5)):
            (point,), (direction,) = self.route.at(distance + random.uniform(-1.5, 1.5))
            side = turned(direction[None], np.pi / 2)[0] * random.choice([-1.0, 1.0])
            yaw = float(np.arctan2(direction[1], direction[0]))
            kind = kinds[k % len(kinds)]
            if kind == "bicycles":
                self._bicycles(point + side * (ROAD_M / 2 + 1.0), direction, yaw)
            elif kind == "group":
                self._group(point + side * (ROAD_M / 2 + random.uniform(0.8, 1.2)))
            elif kind == "rubble":
                self._rubble(point + side * (ROAD_M / 2 - random.uniform(0.0, 1.0)))
            elif self._off_crossings(float(point[0]), float(point[1]), 4.0):
                x, y = point + side * (ROAD_M / 2 - 1.2)
                if self.free(x, y, 2.4):
                    for n in (-1, 0, 1):
                        u, v = (x, y) + direction * 2.1 * n + side * 0.4 * abs(n)
                        piece = furniture.barrier(self.things.new("barrier"))
                        self.put(piece, u, v, yaw + n * 0.25)

    def _rubble(self, at: Array) -> None:
        """A heap at the kerb, and now and then a person who lies beside it."""
        random = self.random
        x, y = at
        radius = random.uniform(1.1, 2.0)
        if not self.free(x, y, radius):
            return
        self.put(rubble(self.things.new("object"), random, radius, 0.55 * radius), x, y)
        if random.random() < 0.4:
            angle = random.uniform(0, 2 * np.pi)
            u, v = at + (radius + 0.9) * np.array([np.cos(angle), np.sin(angle)])
            if self.free(u, v, 0.8):
                self._lying_person(u, v)

    def _lying_person(self, x: float, y: float) -> None:
        random = self.random
        build = Build.draw(random)
        base = standing(x, y, random.uniform(0, 2 * np.pi), ground_height(self.grid, x, y))
        poses = base @ lying(build, random)
        for part, pose in zip(limbs(self.things.new("person"), build), poses, strict=True):
            self.still.insert(part, pose)

    def _bicycles(self, at: Array, along: Array, yaw: float) -> None:
        random = self.random
        for k in range(int(random.integers(2, 6))):
            x, y = at + along * 0.75 * k
            if not self._on_sidewalk(x, y) or not self.free(x, y, 0.3):
                continue
            color = tuple(random.uniform(0.03, 0.5, 3))
            turn = yaw + np.pi / 2 + random.normal(0, 0.06)
            self.put(bicycle(self.things.new("bicycle"), color), x, y, turn)
            if k % 2:
                hoop = furniture.bicycle_stand(self.things.new("object"))
                self.put(hoop, x + along[0] * 0.3, y + along[1] * 0.3, yaw + np.pi / 2)

    def _group(self, at: Array) -> None:
        """One to three persons who stand and talk."""
        random = self.random
        count = int(random.integers(1, 4))
        first = random.uniform(0, 2 * np.pi)
        for k in range(count):
            angle = first + 2 * np.pi * k / count
            x, y = at + 0.55 * np.array([np.cos(angle), np.sin(angle)])
            if not self._on_sidewalk(x, y) or not self.free(x, y, 0.3):
                continue
            vest = VEST if self.wrecked and k == 0 else None  # one of them is of the rescuers
            build = Build.draw(random, shirt=vest)
            base = standing(x, y, angle + np.pi, ground_height(self.grid, x, y))
            poses = base @ walking(build, random.uniform(0, 6.28), stride=0.15)
            for part, pose in zip(limbs(self.things.new("person"), build), poses, strict=True):
                self.still.insert(part, pose)

    def cast(self, flight: Flight, *, operated: bool) -> Cast:
        """Walkers on the sidewalks and across the street, cyclists, cars, and the operator who
        follows an aircraft."""
        random, cast = self.random, Cast()
        actors = cast.actors
        if operated:
            actors.append(new_operator(self.things, random, self.grid, flight))
        for distance in np.arange(4.0, self.route.length_m + 30.0, 6.0):
            (point,), (direction,) = self.route.at(distance)
            side = turned(direction[None], np.pi / 2)[0] * random.choice([-1.0, 1.0])
            if random.random() < 0.4 and self._clear(point, side):
                start = point - side * (ROAD_M / 2 + 1.5)
                stop = point + side * (ROAD_M / 2 + 1.5)
            else:
                lane = point + side * (ROAD_M / 2 + random.uniform(1.8, 2.4))
                start, stop = lane - direction * 11.0, lane + direction * 11.0
            actors.append(new_walker(self.things, random, self.grid, start, stop))
        self._riders(cast)
        return cast

    def _clear(self, point: Array, side: Array) -> bool:
        """Whether nothing stands where a person would cross the street."""
        line = point + np.linspace(-4.5, 4.5, 10)[:, None] * side
        return all(np.hypot(*(line - (x, y)).T).min() > r + 0.2 for x, y, r in self._taken)

    def _riders(self, cast: Cast) -> None:
        """Two cars and a cyclist on the streets of the route, one on each lane."""
        random = self.random
        legs = pairwise(self.route.points)
        for leg, (a, b) in enumerate(legs):
            along = (b - a) / np.linalg.norm(b - a)
            left = turned(along[None], np.pi / 2)[0]
            for lane, way in ((-1.0, 1.0), (1.0, -1.0)):
                offset = left * lane * 1.3
                ends = (a - along * 40.0 * way, b + along * 40.0 * way)
                start, stop = ends if way > 0 else (b + along * 40.0, a - along * 40.0)
                if leg < 6 and random.random() < 0.5:
                    kind = KINDS[random.integers(len(KINDS))]
                    paint = int(random.integers(len(PAINTS)))
                    ride = (start + offset, stop + offset)
                    cast.actors.append(new_driver(self.things, random, ride, kind, paint))
                elif leg < 8:
                    ride = (start + offset * 1.5, stop + offset * 1.5)
                    cyclist = new_cyclist(self.things, random, ride, random.uniform(0.2, 0.7))
                    cast.actors.append(cyclist)


def _row(middle: Array, along: Array) -> list[tuple[float, float, float]]:
    """Places (x, y, radius) that a vehicle of 8 m takes."""
    points = [middle + along * k for k in (-3.0, -1.0, 1.0, 3.0)]
    return [(float(x), float(y), 1.6) for x, y in points]
