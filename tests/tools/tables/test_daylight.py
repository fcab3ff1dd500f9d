"""Fig 18: what both cameras show, and which of them finds it, by distance."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="training needs the extra 'train'")

from judged_scans import PERSON, ROAD, VEHICLE

from pipeline.message import Message
from stages.labels import Labels
from stages.types import Detections, Image
from tools.tables.daylight import (
    RGB,
    THERMAL,
    Found,
    Seen,
    beside,
    compared,
    judged,
    recall_over_distance,
    table_of,
    told_by,
)


def seen(
    camera: str, truth: dict[int, tuple[int, list[int]]], found: list[tuple[int, list[int], float]]
) -> Seen:
    """Things as (class, box) and detections as (class, box, score) in an image of 60 x 80."""
    classes, instances = np.full((60, 80), ROAD, np.uint8), np.ones((60, 80), np.uint16)
    for thing, (label, (x0, y0, x1, y1)) in truth.items():
        classes[y0:y1, x0:x1], instances[y0:y1, x0:x1] = label, thing
    boxes = np.array([box for _, box, _ in found], np.float32).reshape(-1, 4)
    detections = Detections(
        boxes,
        np.array([label for label, _, _ in found], np.int64),
        np.array([score for _, _, score in found], np.float32),
        camera,
    )
    image = Message.at(7, Image(np.zeros((60, 80, 3), np.uint8), camera))
    return judged(image, detections, Labels(classes, instances, camera))


MAN, CAR = [10, 10, 16, 26], [40, 20, 70, 40]


def test_a_detection_finds_the_object_of_its_class_that_it_lies_on() -> None:
    one = seen(
        RGB,
        {5: (PERSON, MAN), 6: (VEHICLE, CAR)},
        [(PERSON, CAR, 0.9), (VEHICLE, CAR, 0.5), (VEHICLE, [0, 50, 9, 58], 0.8)],
    )
    assert one.things.tolist() == [-1, 6, -1]


def test_two_detections_of_one_object_are_one_right_and_one_wrong() -> None:
    one = seen(RGB, {5: (PERSON, MAN)}, [(PERSON, MAN, 0.5), (PERSON, MAN, 0.9)])
    assert one.things.tolist() == [-1, 5]  # the surer one


def test_only_what_both_cameras_show_is_compared() -> None:
    color = seen(RGB, {5: (PERSON, MAN), 6: (VEHICLE, CAR)}, [(VEHICLE, CAR, 0.9)])
    thermal = seen(THERMAL, {5: (PERSON, MAN)}, [(PERSON, MAN, 0.9)])
    distance_m = np.zeros(9)
    distance_m[[5, 6]] = 33.0, 12.0
    (one,) = compared((color, thermal), distance_m)
    assert (one.label, one.distance_m, one.by) == (PERSON, 33.0, {THERMAL})
    assert told_by([one]) == (33.0, 1)
    picture = beside((color, thermal), distance_m)
    assert picture.shape == (60, 160, 3)


def test_recall_is_by_distance_and_class() -> None:
    both, thermal, none = frozenset({RGB, THERMAL}), frozenset({THERMAL}), frozenset[str]()
    found = [Found(0, PERSON, d, by) for d, by in ((5, both), (5, none), (50, thermal))]
    found.append(Found(0, VEHICLE, 50, none))
    near, far = recall_over_distance(found, "person")
    assert near == (0, 10, 2, {RGB: 0.5, THERMAL: 0.5, "either": 0.5})
    assert far == (45, 70, 1, {RGB: 0, THERMAL: 1, "either": 1})
    text = table_of(found, {RGB: np.array([2, 1]), THERMAL: np.array([0, 0])})
    assert "| vehicle | 45 to 70 | 1 | 0 | 0 | 0 |" in text
    assert "rgb 50 % of 2, thermal nothing" in text
