"""The LiDAR measures what geometry says, from where the sensor is at each column."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from stages.simulation.hits import Hits
from stages.simulation.lidar import sweep
from stages.simulation.materials import Material
from stages.simulation.mesh import Mesh, Surface
from stages.simulation.scene import Model
from stages.simulation.trace import Packet

AZIMUTHS = np.pi - 2 * np.pi * (np.arange(64) + 0.5) / 64
ELEVATIONS = np.radians(np.linspace(10, -60, 24))


def scanned(
    surface: Surface, heights: NDArray[np.float64], noise_m: float = 0.0, dust: float = 0.0
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint16]]:
    """A sweep over a wide plane at z = 0, the sensor at a height (m) per column."""
    mesh = Mesh()
    mesh.quad(5, surface, [(-99, -99, 0), (99, -99, 0), (99, 99, 0), (-99, 99, 0)])
    poses = np.broadcast_to(np.eye(4)[:3], (64, 3, 4)).astype(np.float32).copy()
    poses[:, 2, 3] = heights
    ranges, shine = np.empty((24, 64), dtype=np.float32), np.empty((24, 64), dtype=np.float32)
    things = np.empty((24, 64), dtype=np.uint16)
    sweep(
        *(Model.of(mesh, []).scene, Packet.new(), Hits.new(), 0, 64, poses, AZIMUTHS, ELEVATIONS),
        *(0.3, 50.0, 400.0, noise_m, dust, 11, ranges, shine, things),
    )
    return ranges, shine, things


def test_the_range_of_the_ground_is_the_height_of_the_column_over_the_sine() -> None:
    heights = np.linspace(2.0, 4.0, 64)
    ranges, _, things = scanned(Surface(Material.PLAIN), heights)
    expected = heights[None, :] / np.sin(-ELEVATIONS)[:, None]
    down = (ELEVATIONS < 0)[:, None] & (expected < 50.0)
    assert ranges[down] == pytest.approx(expected[down], rel=1e-4)
    assert (ranges[~down] == 0).all()
    assert (things[down] == 5).all()
    assert (things[~down] == 0).all()


def test_range_noise_has_the_size_that_the_sensor_states() -> None:
    heights = np.full(64, 3.0)
    clean, _, _ = scanned(Surface(Material.PLAIN), heights)
    noisy, _, _ = scanned(Surface(Material.PLAIN), heights, noise_m=0.02)
    error = (noisy - clean)[-6:]
    assert error.std() == pytest.approx(0.02, rel=0.25)


def test_bright_ground_shines_brighter_than_asphalt() -> None:
    heights = np.full(64, 3.0)
    lawn = scanned(Surface(Material.LAWN), heights)[1]
    road = scanned(Surface(Material.ASPHALT), heights)[1]
    assert np.median(lawn[-6:]) > 2 * np.median(road[-6:])


def test_dust_swallows_far_returns_and_leaves_near_ones() -> None:
    heights = np.full(64, 3.0)
    clear, _, _ = scanned(Surface(Material.PLAIN), heights)
    dusty, _, _ = scanned(Surface(Material.PLAIN), heights, dust=0.15)
    near, far = (clear > 0) & (clear < 6.0), clear > 25.0
    assert (dusty[near] == clear[near]).all()
    assert np.count_nonzero(dusty[far]) < 0.5 * np.count_nonzero(far)
