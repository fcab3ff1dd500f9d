"""Whatever a network gives, a detector finds sound boxes or none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from head_oracle import stored

from pipeline.message import Message
from pipeline.model import ModelSpec, Tensor
from stages.detect import DetectObjects
from stages.types import Image

CLASSES = {0: "person", 1: "vehicle", 2: "bicycle"}
ANCHORS: list[dict[str, Any]] = [
    {"kind": "ssd", "maps": [[3, 4], 1], "scales": [0.3, 0.8]},
    {"kind": "multiscale", "levels": [4, 5], "ratios": [1.0], "per_octave": 1},
]
HEADS: dict[str, dict[str, Any]] = {
    "detection_output": {},
    "fastestdet": {},
    "ssd": {"anchors": ANCHORS[0]},
    "ssd_postprocessed": {},
    "yolo": {},
    "centernet": {},
}
SETTINGS: dict[str, list[dict[str, Any]]] = {
    "ssd": [
        {"scores": "softmax"},
        {"scores": "softmax", "background": False},
        {"scores": "probability"},
        {"anchors": ANCHORS[1]},
        {},
    ],
    "yolo": [{"strides": [16]}, {"objectness": False, "unit": "parts"}, {}],
    "centernet": [{"log_size": True, "heat": "probability"}, {}],
}
SHAPES: dict[str, Callable[[dict[str, Any]], dict[str, tuple[int, ...]]]] = {
    "detection_output": lambda head: {"detections": (1, 1, 9, 7)},
    "fastestdet": lambda head: {"grid": (1, 3, 4, 8)},
    "ssd": lambda head: {
        "boxes": (1, 42 if head["anchors"]["kind"] == "ssd" else 16, 4),
        "scores": (1, 42 if head["anchors"]["kind"] == "ssd" else 16, 3),
    },
    "ssd_postprocessed": lambda head: {
        "boxes": (1, 9, 4),
        "classes": (1, 9),
        "scores": (1, 9),
        "count": (1,),
    },
    "yolo": lambda head: {"rows": (1, 12, 8)},
    "centernet": lambda head: {
        "heat": (1, 3, 4, 3),
        "size": (1, 3, 4, 2),
        "offset": (1, 3, 4, 2),
    },
}
ODD = [np.nan, np.inf, -np.inf, 3.4e38, -3.4e38, 1e-45, 0.0, -1.0, 0.5, 1.0, 2.0, 100.0]


def odd_tensor(random: np.random.Generator, shape: tuple[int, ...]) -> Tensor:
    """Plausible, sprinkled with odd numbers, all odd, or all equal; as float or 8 bit."""
    form = random.integers(6)
    values = random.normal(0, random.choice([0.5, 3]), shape)
    if random.integers(2):
        values = np.abs(values)
    if form < 3:
        odd = random.random(shape) < [0.1, 0.5, 1.0][form]
        return Tensor(np.where(odd, random.choice(ODD, shape), values).astype(np.float32))
    if form == 3:
        return Tensor(np.full(shape, random.choice(ODD), np.float32))
    if form == 4:
        return stored(values, ["int8", "uint8"][random.integers(2)])
    array = random.integers(-128, 128, shape).astype(np.int8)
    return Tensor(
        array, float(random.choice([1e-30, 1e-3, 1.0, 1e30])), int(random.integers(-9, 9))
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", HEADS)
def test_ten_thousand_odd_outputs_give_sound_boxes_or_none(kind: str) -> None:
    random = np.random.default_rng(7)
    stages = []
    for settings in SETTINGS.get(kind, [{}]):
        for letterbox in (False, True):
            for stage in (
                DetectObjects(),
                DetectObjects(min_score=1e-6, max_iou=1.0, max_boxes=7),
            ):
                head = {"kind": kind, "class_map": CLASSES, "letterbox": letterbox}
                head |= HEADS[kind] | settings
                stage.model = ModelSpec("net", "image", (48, 64, 3), "uint8", "rgb", head)
                stage.open()
                stages.append((stage, SHAPES[kind](head)))
    found = 0
    for _ in range(10_000 // len(HEADS) + 1):
        stage, shapes = stages[random.integers(len(stages))]
        outputs = {name: odd_tensor(random, shape) for name, shape in shapes.items()}
        if "count" in outputs and random.integers(2):
            outputs["count"] = Tensor(np.array([9.0], np.float32))
        height, width = random.choice([1, 2, 48, 640, 848], 2)
        image = Image(np.zeros((height, width), np.uint8), "thermal")
        result = stage.finish(outputs, Message.at(0, image))
        assert np.isfinite(result.boxes).all()
        assert (result.boxes >= 0).all()
        assert (result.boxes <= [width, height, width, height]).all()
        assert (result.boxes[:, 2:] - result.boxes[:, :2] >= 2).all()
        assert ((result.scores >= stage.min_score) & (result.scores <= 1)).all()
        assert (np.diff(result.scores) <= 0).all(), "best first"
        assert len(result.boxes) <= stage.max_boxes
        assert len(result.boxes) == len(result.classes) == len(result.scores)
        found += len(result.boxes)
    assert found > 50, "this test must also see boxes"
    assert sum(stage.statistics()["broken_boxes"] for stage, _ in stages) > 100, "and broken ones"
