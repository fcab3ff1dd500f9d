"""The packet tracer against every ray tried on every triangle."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from stages.simulation.materials import Material
from stages.simulation.mesh import Mesh, Surface, standing
from stages.simulation.scene import Model
from stages.simulation.trace import DX, NOTHING, OX, PACKET, STATIC, Packet, Scene, T, trace

GRAY = Surface(Material.PLAIN)


def soup(random: np.random.Generator, count: int, spread: float) -> Mesh:
    mesh = Mesh()
    middles = random.uniform(-spread, spread, (count, 1, 3))
    mesh.add(1, GRAY, middles + random.normal(0, 0.6, (count, 3, 3)))
    return mesh


def brute_force(
    triangles: NDArray[np.float64], origin: NDArray[np.float64], direction: NDArray[np.float64]
) -> float:
    """Distance to the nearest of the triangles (n, 3, 3), by solving for each; inf for none."""
    a, u, v = (
        triangles[:, 0],
        triangles[:, 1] - triangles[:, 0],
        triangles[:, 2] - triangles[:, 0],
    )
    system = np.stack([u, v, np.broadcast_to(-direction, u.shape)], axis=-1)
    b, c, t = np.linalg.solve(system, (origin - a)[..., None])[..., 0].T
    hit = (b >= 0) & (c >= 0) & (b + c <= 1) & (t > 1e-3)
    return float(t[hit].min(initial=np.inf))


def aimed(random: np.random.Generator, limit: float) -> Packet:
    packet = Packet.new()
    directions = random.normal(0, 1, (3, PACKET))
    packet.rays[OX : OX + 3] = random.uniform(-6, 6, (3, PACKET))
    packet.rays[DX : DX + 3] = directions / np.linalg.norm(directions, axis=0)
    packet.rays[T] = limit
    return packet


def moved(mesh: Mesh, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    corners = np.concatenate(mesh.corners)
    return np.asarray(corners @ pose[:3, :3].T + pose[:3, 3])


@pytest.fixture(scope="module", params=range(3))
def world(request: pytest.FixtureRequest) -> tuple[Scene, NDArray[np.float64], int]:
    """A scene of 300 still triangles and two moved parts; all triangles; how many stand still."""
    random = np.random.default_rng(request.param)
    still, parts = soup(random, 300, 5.0), [soup(random, 40, 1.0) for _ in range(2)]
    poses = np.stack([standing(2.0, -1.0, 0.7, 0.5), standing(-3.0, 2.0, -2.0, -1.0)])
    triangles = [moved(still, np.eye(4))]
    triangles += [moved(part, pose) for part, pose in zip(parts, poses, strict=True)]
    return Model.of(still, parts).at(poses), np.concatenate(triangles), 300


def test_a_ray_meets_what_trying_every_triangle_finds(
    world: tuple[Scene, NDArray[np.float64], int],
) -> None:
    scene, triangles, _ = world
    random = np.random.default_rng(9)
    met = 0
    for _ in range(12):
        packet = aimed(random, 100.0)
        trace(scene, packet, False)
        for k in range(PACKET):
            ray = packet.rays[:, k].astype(np.float64)
            expected = brute_force(triangles, ray[OX : OX + 3], ray[DX : DX + 3])
            if np.isinf(expected):
                assert packet.triangle[k] == NOTHING
            else:
                assert ray[T] == pytest.approx(expected, abs=2e-3)
                met += 1
    assert met > 80


def test_what_moves_is_told_from_what_stands_still(
    world: tuple[Scene, NDArray[np.float64], int],
) -> None:
    scene, triangles, still = world
    random = np.random.default_rng(10)
    parts = set()
    for _ in range(12):
        packet = aimed(random, 100.0)
        trace(scene, packet, False)
        for k in np.flatnonzero(packet.triangle != NOTHING):
            ray = packet.rays[:, k].astype(np.float64)
            alone = brute_force(triangles[:still], ray[OX : OX + 3], ray[DX : DX + 3])
            assert (packet.part[k] == STATIC) == (alone <= ray[T] + 2e-3)
            parts.add(int(packet.part[k]))
    assert parts == {STATIC, 0, 1}


def test_a_ray_is_blocked_exactly_where_it_would_hit(
    world: tuple[Scene, NDArray[np.float64], int],
) -> None:
    scene, _, _ = world
    for seed in range(8):
        near = aimed(np.random.default_rng(seed), 4.0)
        blocked = aimed(np.random.default_rng(seed), 4.0)
        trace(scene, near, False)
        trace(scene, blocked, True)
        assert np.array_equal(near.triangle != NOTHING, blocked.triangle != NOTHING)


def test_a_ray_with_a_limit_below_zero_meets_nothing(
    world: tuple[Scene, NDArray[np.float64], int],
) -> None:
    packet = aimed(np.random.default_rng(1), -1.0)
    trace(world[0], packet, False)
    assert (packet.triangle == NOTHING).all()


def test_rays_along_the_axes_are_traced() -> None:
    mesh = Mesh()
    mesh.box(1, GRAY, (0.0, 0.0, 0.0), (2.0, 2.0, 2.0), bottom=True)
    packet = Packet.new()
    packet.rays[T] = -1.0
    for k in range(6):
        sign, axis = (1.0 if k < 3 else -1.0), k % 3
        packet.rays[OX : OX + 3, k] = 0.25
        packet.rays[OX + axis, k] = -5.0 * sign
        packet.rays[DX + axis, k] = sign
        packet.rays[T, k] = 100.0
    trace(Model.of(mesh, []).scene, packet, False)
    assert packet.rays[T, :6] == pytest.approx(4.0, abs=1e-5)
