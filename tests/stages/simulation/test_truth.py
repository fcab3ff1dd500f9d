"""Boxes and voxels of the ground truth."""

from __future__ import annotations

import numpy as np

from stages.labels import Labels
from stages.simulation.materials import Material
from stages.simulation.mesh import Mesh, Surface
from stages.simulation.truth import MIN_PIXELS, visible_boxes, voxel_truth
from stages.taxonomy import load_taxonomy

TAXONOMY = load_taxonomy()


def test_a_box_encloses_the_visible_pixels_of_its_object() -> None:
    classes = np.full((40, 60), TAXONOMY.id("road"), dtype=np.uint8)
    instances = np.full((40, 60), 1, dtype=np.uint16)
    classes[10:20, 5:12], instances[10:20, 5:12] = TAXONOMY.id("person"), 7
    classes[12, 30:34], instances[12, 30:34] = TAXONOMY.id("bicycle"), 8
    found = visible_boxes(Labels(classes, instances, "rgb"))
    assert MIN_PIXELS > 4
    assert found.boxes.tolist() == [[5.0, 10.0, 11.0, 19.0]]
    assert found.classes.tolist() == [TAXONOMY.id("person")]
    assert found.camera == "rgb"


def test_an_image_without_objects_has_no_boxes() -> None:
    empty = np.zeros((8, 8), dtype=np.uint8)
    assert visible_boxes(Labels(empty, empty.astype(np.uint16), "rgb")).boxes.shape == (0, 4)


def test_the_voxels_of_a_floor_and_a_wall_are_all_there_and_no_others() -> None:
    mesh = Mesh()
    gray = Surface(Material.PLAIN)
    mesh.quad(1, gray, [(0, 0, 0.1), (2, 0, 0.1), (2, 2, 0.1), (0, 2, 0.1)])
    mesh.quad(2, gray, [(0, 1.1, 0.3), (2, 1.1, 0.3), (2, 1.1, 1.2), (0, 1.1, 1.2)])
    classes = np.array([8, 3, 1], dtype=np.uint8)
    voxels = voxel_truth(mesh, classes, np.array([[1.0, 1.0]]), voxel_m=0.25)
    found = {
        tuple(index): int(kind)
        for index, kind in zip(voxels.indices.tolist(), voxels.classes, strict=True)
    }
    floor = {(x, y, 0): 3 for x in range(8) for y in range(8)}
    wall = {(x, 4, z): 1 for x in range(8) for z in range(1, 5)}
    assert found == floor | wall


def test_voxels_beyond_the_reach_of_the_track_are_left_out() -> None:
    mesh = Mesh()
    mesh.quad(0, Surface(Material.PLAIN), [(-99, -99, 0), (99, -99, 0), (99, 99, 0), (-99, 99, 0)])
    track = np.array([[0.0, 0.0]])
    voxels = voxel_truth(mesh, np.array([3], dtype=np.uint8), track, reach_m=5.0)
    away = np.hypot(*((voxels.indices[:, :2] + 0.5) * 0.25).T)
    assert away.max() < 5.3
    assert len(voxels.classes) > 1200
