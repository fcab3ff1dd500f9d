"""The flight follows its route, smoothly, and is the seed's."""

from __future__ import annotations

import numpy as np
import pytest

from stages.kernels.geometry import rotation_log
from stages.simulation.streets import Grid
from stages.simulation.trajectory import STEP_S, Flight, Route


def flight(seed: int) -> tuple[Grid, Flight]:
    random = np.random.default_rng(seed)
    grid = Grid.draw(random, 6)
    route = Route.draw(random, grid, 120.0)
    return grid, Flight.fly(random, route, 40.0, 2.6, (4.0, 8.0))


@pytest.mark.parametrize("seed", range(5))
def test_the_vehicle_stays_over_the_streets_between_its_heights(seed: int) -> None:
    grid, path = flight(seed)
    x, y, z = path.map_from_base[:, :3, 3].T
    across = np.minimum(
        np.abs(x[:, None] - grid.xs).min(axis=1), np.abs(y[:, None] - grid.ys).min(axis=1)
    )
    assert across.max() < 6.5
    assert z.min() >= 4.0
    assert z.max() <= 8.0


@pytest.mark.parametrize("seed", range(3))
def test_speed_turn_and_tilt_are_those_of_a_careful_pilot(seed: int) -> None:
    _, path = flight(seed)
    velocity = np.gradient(path.map_from_base[:, :3, 3], STEP_S, axis=0)
    assert 0.5 < np.linalg.norm(velocity, axis=1).mean() < 3.5
    rotation = path.map_from_base[:, :3, :3]
    turn = rotation_log(np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:]) / STEP_S
    assert np.linalg.norm(turn, axis=1).max() < 2.0
    assert np.degrees(np.arccos(rotation[:, 2, 2])).max() < 20.0


def test_a_route_is_walked_at_its_own_pace_and_goes_straight_on_at_its_ends() -> None:
    route = Route(np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 5.0]]), 12.0)
    points, directions = route.at(np.array([-2.0, 4.0, 12.0, 17.0]))
    assert points == pytest.approx(np.array([[-2, 0], [4, 0], [10, 2], [10, 7]]))
    assert directions == pytest.approx(np.array([[1, 0], [1, 0], [0, 1], [0, 1]]))


def test_the_same_seed_flies_the_same_way() -> None:
    assert np.array_equal(flight(4)[1].map_from_base, flight(4)[1].map_from_base)
    assert not np.array_equal(flight(4)[1].map_from_base, flight(5)[1].map_from_base)
