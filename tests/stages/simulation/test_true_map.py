"""The true voxel map: all surfaces and no others, and in mixed voxels what can be seen."""

from __future__ import annotations

import numpy as np

from stages.labels import LabeledVoxels
from stages.simulation.materials import Material
from stages.simulation.mesh import Mesh, Surface
from stages.simulation.true_map import voxel_truth

GRAY = Surface(Material.PLAIN)
#: Class by thing.
SKY, ROAD, BUILDING, VEGETATION = 8, 3, 1, 7
CLASSES = np.array([SKY, ROAD, BUILDING, VEGETATION], dtype=np.uint8)
ABOVE = np.array([[1.0, 1.0, 5.0]])


def by_index(voxels: LabeledVoxels) -> dict[tuple[int, ...], int]:
    indices = map(tuple, voxels.indices.tolist())
    return dict(zip(indices, voxels.classes.tolist(), strict=True))


def floor(mesh: Mesh, thing: int, x0: float, y0: float, x1: float, y1: float, z: float) -> None:
    mesh.quad(thing, GRAY, [(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)])


def test_the_voxels_of_a_floor_and_a_wall_are_all_there_and_no_others() -> None:
    mesh = Mesh()
    floor(mesh, 1, 0, 0, 2, 2, 0.1)
    mesh.quad(2, GRAY, [(0, 1.1, 0.3), (2, 1.1, 0.3), (2, 1.1, 1.2), (0, 1.1, 1.2)])
    found = by_index(voxel_truth(mesh, CLASSES, ABOVE, voxel_m=0.25))
    ground = {(x, y, 0): ROAD for x in range(8) for y in range(8)}
    wall = {(x, 4, z): BUILDING for x in range(8) for z in range(1, 5)}
    assert found == ground | wall


def test_voxels_beyond_the_reach_of_the_track_are_left_out() -> None:
    mesh = Mesh()
    floor(mesh, 1, -99, -99, 99, 99, 0)
    voxels = voxel_truth(mesh, CLASSES, np.array([[0.0, 0.0, 4.0]]), reach_m=5.0)
    away = np.hypot(*((voxels.indices[:, :2] + 0.5) * 0.25).T)
    assert away.max() < 5.3
    assert len(voxels.classes) > 1200


def test_what_is_hidden_from_the_track_does_not_count_beside_what_is_seen() -> None:
    mesh = Mesh()
    floor(mesh, 3, 0, 0, 2, 2, 0.05)  # a lawn that goes on under the house
    mesh.box(2, GRAY, (1.0, 1.0, 0.12), (1.9, 1.9, 0.15))  # low enough to share its voxels
    index = (4, 4, 0)
    assert by_index(voxel_truth(mesh, CLASSES, ABOVE))[index] == BUILDING
    below = np.array([[1.0, 1.0, -5.0]])
    assert by_index(voxel_truth(mesh, CLASSES, below))[index] == VEGETATION


def test_many_small_triangles_weigh_no_more_than_their_area() -> None:
    mesh = Mesh()
    floor(mesh, 1, 0, 0, 0.25, 0.25, 0.02)
    for row in range(10):  # 200 triangles over a quarter of that area, above it
        for column in range(10):
            x, y = 0.0125 * column, 0.0125 * row
            floor(mesh, 2, x, y, x + 0.0125, y + 0.0125, 0.06)
    assert by_index(voxel_truth(mesh, CLASSES, ABOVE)) == {(0, 0, 0): ROAD}


def test_where_nothing_can_be_seen_the_larger_surface_counts() -> None:
    mesh = Mesh()
    floor(mesh, 2, -5, -5, 5, 5, 2.0)  # a roof over all
    floor(mesh, 1, 0, 0, 0.25, 0.25, 0.02)
    floor(mesh, 3, 0, 0, 0.125, 0.25, 0.06)
    assert by_index(voxel_truth(mesh, CLASSES, ABOVE))[0, 0, 0] == ROAD
