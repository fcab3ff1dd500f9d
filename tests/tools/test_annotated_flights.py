"""What is true of a flight as annotations."""

from __future__ import annotations

import numpy as np

from stages.labels import Labels
from stages.simulation.truth import visible_boxes
from stages.taxonomy import load_taxonomy
from tools.annotated_flights import as_drawn


def test_a_drawn_box_goes_around_all_pixels_and_riders_are_left_out() -> None:
    taxonomy = load_taxonomy()
    instances = np.zeros((40, 60), np.uint16)
    instances[10:20, 5:11], instances[20:30, 30:40] = 1, 2
    classes = np.zeros((40, 60), np.uint8)
    classes[instances == 1] = taxonomy.id("person")
    classes[instances == 2] = taxonomy.id("rider")
    boxes, labels = as_drawn(visible_boxes(Labels(classes, instances, "rgb")))
    assert boxes.tolist() == [[5, 10, 11, 20], [30, 20, 40, 30]]
    assert labels.tolist() == [taxonomy.id("person"), -1]
