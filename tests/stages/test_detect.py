from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from accelerators.litert import TfliteCpu
from accelerators.onnx import Onnx
from accelerators.openvino import OpenVino
from accelerators.registry import Registry
from pipeline.errors import ModelError, StageError
from pipeline.message import Message
from pipeline.model import Accelerator, ModelSpec, Tensor
from stages.detect import DetectObjects
from stages.taxonomy import load_taxonomy
from stages.types import Detections, Image

TAXONOMY = load_taxonomy()
HEAD: dict[str, Any] = {
    "kind": "detection_output",
    "class_map": {0: "vehicle", 1: "person", 4: "vehicle"},
}


def opened(head: dict[str, Any] = HEAD, **options: Any) -> DetectObjects:
    stage = DetectObjects(**options)
    stage.model = ModelSpec("net", "image", (100, 100, 3), "uint8", "bgr", head)
    stage.open()
    return stage


def photo(width: int = 200, height: int = 50) -> Message[Image]:
    noise = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    return Message.at(5, Image(noise, "front"))


def found(rows: list[list[float]], **options: Any) -> Detections:
    """What comes out of DetectionOutput rows of class, score, x0, y0, x1, y1."""
    table = np.array([[0, *row] for row in rows], dtype=np.float32).reshape(1, 1, -1, 7)
    return opened(**options).finish({"detections": Tensor(table)}, photo())


def test_boxes_are_pixels_of_the_full_image_in_our_classes_best_first() -> None:
    result = found([[1, 0.6, 0.5, 0.5, 0.6, 0.9], [0, 0.9, 0.1, 0.2, 0.3, 0.4]])
    np.testing.assert_allclose(result.boxes, [[20, 10, 60, 20], [100, 25, 120, 45]], rtol=1e-5)
    assert result.classes.tolist() == [TAXONOMY.id("vehicle"), TAXONOMY.id("person")]
    np.testing.assert_allclose(result.scores, [0.9, 0.6], rtol=1e-6)
    assert result.camera == "front"
    assert (result.boxes.dtype, result.classes.dtype) == (np.float32, np.int64)


def test_nothing_found_is_an_empty_payload() -> None:
    result = found([[0, 0.0, 0, 0, 0, 0]])
    assert (result.boxes.shape, result.classes.shape) == ((0, 4), (0,))


def test_weak_unmapped_and_tiny_boxes_are_dropped() -> None:
    keep = [0, 0.9, 0.1, 0.2, 0.3, 0.4]
    weak = [0, 0.3, 0.5, 0.5, 0.6, 0.6]
    unmapped = [2, 0.9, 0.5, 0.5, 0.6, 0.6]
    beyond_the_map = [77, 0.9, 0.5, 0.5, 0.6, 0.6]
    flat = [0, 0.9, 0.1, 0.500, 0.3, 0.539]  # 1.95 px of 50
    outside = [0, 0.9, 1.1, 0.2, 1.3, 0.4]
    result = found([keep, weak, unmapped, beyond_the_map, flat, outside])
    np.testing.assert_allclose(result.boxes, [[20, 10, 60, 20]], rtol=1e-5)


def test_two_of_the_networks_classes_that_are_one_of_ours_count_once() -> None:
    car, truck = [0, 0.9, 0.1, 0.2, 0.3, 0.4], [4, 0.8, 0.1, 0.2, 0.31, 0.4]
    person = [1, 0.7, 0.1, 0.2, 0.3, 0.4]
    result = found([car, truck, person])
    assert result.classes.tolist() == [TAXONOMY.id("vehicle"), TAXONOMY.id("person")]


def test_max_boxes_keeps_the_best() -> None:
    rows = [[0, 0.5 + i / 100, i / 10, 0.1, (i + 0.9) / 10, 0.5] for i in range(9)]
    result = found(rows, max_boxes=3)
    np.testing.assert_allclose(result.scores, [0.58, 0.57, 0.56], rtol=1e-5)


def test_the_picture_is_in_the_networks_size_and_color_order() -> None:
    stage = opened()
    image = photo(100, 100)
    array = stage.prepare(image)["image"].array
    np.testing.assert_array_equal(array[0], image.payload.data[..., ::-1])
    assert stage.prepare(photo(300, 40))["image"].array.shape == (1, 100, 100, 3)


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ({"kind": "scores", "class_map": {}}, "DetectObjects takes 'detection_output'"),
        ({"kind": "detection_output", "class_map": {0: "car"}}, "class_map: no class 'car'"),
    ],
)
def test_a_model_that_does_not_fit_is_refused(head: dict[str, Any], said: str) -> None:
    with pytest.raises(ModelError, match=said):
        opened(head)


def test_16_bit_images_are_refused_with_the_way_out() -> None:
    raw = Message.at(0, Image(np.zeros((4, 4), np.uint16), "thermal"))
    with pytest.raises(StageError, match="switch its gain control on"):
        opened().prepare(raw)


@pytest.mark.parametrize(
    "options", [{"min_score": 0.0}, {"max_iou": 1.5}, {"max_boxes": 0}, {"min_score": 2.0}]
)
def test_a_bad_option_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="must be"):
        DetectObjects(**options)


def overlap(box: Any, other: list[float]) -> float:
    """Intersection over union."""
    low, high = np.maximum(box[:2], other[:2]), np.minimum(box[2:], other[2:])
    shared = np.prod(np.maximum(high - low, 0))
    areas = sum(np.prod(np.subtract(one[2:], one[:2])) for one in (box, other))
    return float(shared / (areas - shared))


NETWORKS = [
    ("detect-person-vehicle-bike-2001", OpenVino()),
    ("detect-rgb-fastestdet", Onnx()),
    ("detect-rgb-fastestdet", OpenVino()),
    ("detect-rgb-fastestdet", TfliteCpu()),
    ("detect-person-ssdlite", TfliteCpu()),
]


@pytest.mark.parametrize(("name", "device"), NETWORKS)
def test_every_public_network_finds_the_person(
    shared: Path, name: str, device: Accelerator
) -> None:
    bgr = cv2.imread(str(shared / "models" / "coral" / "squat.bmp"))
    image = Message.at(0, Image(np.ascontiguousarray(bgr[..., ::-1]), "photo"))
    result = DetectObjects().run_once(image, model=Registry.open().load(name, device))
    assert result.classes[0] == TAXONOMY.id("person")
    assert result.scores[0] > 0.9
    assert overlap(result.boxes[0], [106, 136, 365, 597]) > 0.85  # measured by eye


@pytest.mark.parametrize(("name", "device"), NETWORKS[:4])
def test_the_vehicle_networks_find_the_two_nearest_parked_cars(
    shared: Path, name: str, device: Accelerator
) -> None:
    bgr = cv2.imread(str(shared / "data" / "kitti_drive_full6" / "image" / "0000000022.png"))
    image = Message.at(0, Image(np.ascontiguousarray(bgr[..., ::-1]), "camera"))
    result = DetectObjects().run_once(image, model=Registry.open().load(name, device))
    for car in ([16, 194, 242, 283], [252, 180, 362, 240]):  # measured by eye
        overlaps = [overlap(box, car) for box in result.boxes]
        best = int(np.argmax(overlaps))
        assert overlaps[best] > 0.7
        assert result.classes[best] == TAXONOMY.id("vehicle")
