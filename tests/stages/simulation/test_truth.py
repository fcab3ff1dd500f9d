"""Boxes of the ground truth."""

from __future__ import annotations

import numpy as np

from stages.labels import Labels
from stages.simulation.truth import MIN_PIXELS, visible_boxes, visible_things
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


def test_each_box_names_its_thing() -> None:
    classes = np.full((40, 60), TAXONOMY.id("road"), dtype=np.uint8)
    instances = np.full((40, 60), 1, dtype=np.uint16)
    for thing, left in ((9, 5), (7, 30)):
        classes[10:20, left : left + 7] = TAXONOMY.id("person")
        instances[10:20, left : left + 7] = thing
    boxes, things = visible_things(Labels(classes, instances, "rgb"))
    assert things.tolist() == [7, 9]
    assert boxes.boxes[:, 0].tolist() == [30.0, 5.0]
