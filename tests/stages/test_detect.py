from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import pytest

from accelerators.litert import TfliteCpu
from accelerators.onnx import Onnx
from accelerators.openvino import OpenVino
from accelerators.registry import Registry
from accelerators.tensors import BoundFile
from pipeline.errors import ModelError, StageError
from pipeline.message import Message
from pipeline.model import Accelerator, ModelSpec, Tensor
from stages.detect import DetectObjects
from stages.kernels.anchors import decode_anchored, multiscale_anchors
from stages.taxonomy import load_taxonomy
from stages.thermal_agc import ThermalAgc
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
    assert result.boxes.dtype == np.dtype("float32")
    assert result.classes.dtype == np.dtype("int64")


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
        ({"kind": "scores", "class_map": {}}, "a detector's is one of centernet"),
        ({"kind": "detection_output", "class_map": {0: "car"}}, "class_map: no class 'car'"),
    ],
)
def test_a_model_that_does_not_fit_is_refused(head: dict[str, Any], said: str) -> None:
    with pytest.raises(ModelError, match=said):
        opened(head)


def test_outputs_of_another_kind_are_refused_with_the_models_name() -> None:
    with pytest.raises(ModelError, match="model 'net': the head needs an output 'detections'"):
        opened().finish({"boxes": Tensor(np.zeros((1, 4)))}, photo())


def test_broken_boxes_are_dropped_and_counted() -> None:
    stage = opened()
    rows = np.array([[0, 0, 0.9, np.nan, 0.2, 0.3, 0.4], [0, 0, 0.9, 0.1, 0.2, 0.3, np.inf]])
    table = Tensor(rows.astype(np.float32).reshape(1, 1, -1, 7))
    assert len(stage.finish({"detections": table}, photo()).boxes) == 0
    assert stage.statistics() == {"broken_boxes": 2}


def test_a_letterbox_is_undone() -> None:
    """200 x 50 lies in rows 37.5 to 62.5 of the 100 x 100 picture (whole pixels: 38 to 62)."""
    stage = opened(HEAD | {"letterbox": True})
    picture = stage.prepare(photo())["image"].array[0]
    inside = np.flatnonzero((picture != 114).any(axis=(1, 2)))
    top, bottom = inside[0] / 100, (inside[-1] + 1) / 100
    rows = np.array([0, 0, 0.9, 0.25, top, 0.5, bottom], np.float32).reshape(1, 1, 1, 7)
    result = stage.finish({"detections": Tensor(rows)}, photo())
    np.testing.assert_allclose(result.boxes, [[50, 0, 100, 50]], atol=1e-4)


@pytest.mark.parametrize(("color", "channels"), [("gray", 1), ("rgb", 3), ("bgr", 3)])
def test_a_thermal_image_fits_networks_of_one_and_of_three_channels(
    color: str, channels: int
) -> None:
    thermal = np.random.default_rng(0).integers(0, 256, (64, 80), dtype=np.uint8)
    stage = DetectObjects()
    stage.model = ModelSpec("net", "image", (64, 80, channels), "uint8", color, HEAD)
    stage.open()
    array = stage.prepare(Message.at(0, Image(thermal, "thermal")))["image"].array
    assert array.shape == (1, 64, 80, channels)
    assert (array[0] == thermal[..., None]).all()


def test_an_image_without_pixels_is_refused() -> None:
    empty = Message.at(0, Image(np.zeros((0, 4), np.uint8), "thermal"))
    with pytest.raises(StageError, match="camera 'thermal' gives an image without pixels"):
        opened().prepare(empty)


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


def overlap(box: Any, other: Sequence[float]) -> float:
    """Intersection over union."""
    low, high = np.maximum(box[:2], other[:2]), np.minimum(box[2:], other[2:])
    shared = np.prod(np.maximum(high - low, 0))
    areas = sum(np.prod(np.subtract(one[2:], one[:2])) for one in (box, other))
    return float(shared / (areas - shared))


def read(path: Path) -> Message[Image]:
    """A picture of a file."""
    bgr = np.asarray(cv2.imread(str(path)), dtype=np.uint8)
    return Message.at(0, Image(np.ascontiguousarray(bgr[..., ::-1]), "camera"))


NETWORKS = [
    ("detect-person-vehicle-bike-2001", OpenVino()),
    ("detect-person-vehicle-bike-2000", OpenVino()),
    ("detect-person-vehicle-bike-2002", OpenVino()),
    ("detect-rgb-fastestdet", Onnx()),
    ("detect-rgb-fastestdet", OpenVino()),
    ("detect-rgb-fastestdet", TfliteCpu()),
    ("detect-person-ssdlite", TfliteCpu()),
]


@pytest.mark.parametrize(("name", "device"), NETWORKS)
def test_every_public_network_finds_the_person(
    shared: Path, name: str, device: Accelerator
) -> None:
    image = read(shared / "models" / "coral" / "squat.bmp")
    result = DetectObjects().run_once(image, model=Registry.open().load(name, device))
    assert result.classes[0] == TAXONOMY.id("person")
    assert result.scores[0] > 0.9
    assert overlap(result.boxes[0], [106, 136, 365, 597]) > 0.85  # measured by eye


@pytest.mark.parametrize(("name", "device"), [pair for pair in NETWORKS if "ssd" not in pair[0]])
def test_the_vehicle_networks_find_the_two_nearest_parked_cars(
    shared: Path, name: str, device: Accelerator
) -> None:
    image = read(shared / "data" / "kitti_drive_full6" / "image" / "0000000022.png")
    result = DetectObjects().run_once(image, model=Registry.open().load(name, device))
    for car in ([16, 194, 242, 283], [252, 180, 362, 240]):  # measured by eye
        overlaps = [overlap(box, car) for box in result.boxes]
        best = int(np.argmax(overlaps))
        assert overlaps[best] > 0.7
        assert result.classes[best] == TAXONOMY.id("vehicle")


@pytest.mark.parametrize("letterbox", [False, True])
def test_a_letterboxed_and_a_stretched_picture_give_boxes_at_the_same_place(
    shared: Path, letterbox: bool
) -> None:
    model = Registry.open().load("detect-person-ssdlite", TfliteCpu())
    assert isinstance(model, BoundFile)
    model.spec = replace(model.spec, head={**model.spec.head, "letterbox": letterbox})
    image = read(shared / "models" / "coral" / "squat.bmp")
    result = DetectObjects().run_once(image, model=model)
    assert overlap(result.boxes[0], [106, 136, 365, 597]) > 0.85  # measured by eye


def thermal_street(shared: Path) -> Message[Image]:
    """Two walkers in a real thermal image, as the raw counts of a 16-bit camera."""
    path = shared / "data/rgbt_llvip/ir/200004.jpg"
    gray = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), dtype=np.uint16)
    return Message.at(0, Image(gray * np.uint16(3) + np.uint16(6700), "thermal"))


@pytest.mark.parametrize("mode", ["linear", "plateau", "clahe"])
def test_the_nearer_walker_is_found_in_a_raw_thermal_image_behind_its_gain_control(
    shared: Path, mode: Literal["linear", "plateau", "clahe"]
) -> None:
    raw = thermal_street(shared)
    image = Message.at(0, ThermalAgc(mode=mode).run_once(raw))
    model = Registry.open().load("detect-person-ssdlite", TfliteCpu())
    result = DetectObjects(min_score=0.3).run_once(image, model=model)
    assert result.classes.tolist() == [TAXONOMY.id("person")]
    assert overlap(result.boxes[0], [500, 285, 615, 632]) > 0.5  # measured by eye


@pytest.fixture(scope="module")
def traffic(shared: Path) -> list[Message[Image]]:
    """Five frames of a highway."""
    clip = cv2.VideoCapture(str(shared / "models/automl-video/data/traffic_frames.mp4"))
    frames = [clip.read()[1] for _ in range(20)][::4]
    clip.release()
    return [Message.at(0, Image(np.ascontiguousarray(f[..., ::-1]), "bridge")) for f in frames]


def test_the_head_for_anchors_agrees_with_the_files_own_post_processing(
    traffic: list[Message[Image]],
) -> None:
    """The same network whole and cut; the file holds its anchors in 8 bit, we have them exactly."""
    models = Registry.open()
    stage = DetectObjects(min_score=0.25, max_iou=0.6)  # 0.6 is the file's own
    whole = models.load("detect-vehicle-traffic", TfliteCpu())
    parted = models.load("detect-vehicle-traffic-anchors", TfliteCpu())
    matched = 0
    for image in traffic:
        ours, theirs = (stage.run_once(image, model=model) for model in (parted, whole))
        assert (theirs.classes == TAXONOMY.id("vehicle")).all()
        for one, other in ((ours, theirs), (theirs, ours)):
            for box, score in zip(one.boxes, one.scores, strict=True):
                if score > 0.26:  # nearer to the threshold, rounding decides
                    overlaps = [overlap(box, twin) for twin in other.boxes.tolist()]
                    best = int(np.argmax(overlaps))
                    assert overlaps[best] > 0.9  # measured: 0.945 at least
                    assert abs(other.scores[best] - score) < 1 / 256
                    matched += 1
    assert matched > 20


def test_with_the_files_own_anchors_the_agreement_is_exact(traffic: list[Message[Image]]) -> None:
    models = Registry.open()
    whole = models.load("detect-vehicle-traffic", TfliteCpu())
    parted = models.load("detect-vehicle-traffic-anchors", TfliteCpu())
    stage = DetectObjects()
    stage.model = whole.spec
    stage.open()
    step = 0.003860294120386243  # of the tensor "anchors" in the file
    exact = multiscale_anchors((3, 5), 2.0, (0.25, 0.5, 1, 2, 4), 4, (256, 256))
    anchors = (np.rint(exact / step) * step).astype(np.float32)
    for image in traffic:
        picture = stage.prepare(image)
        theirs = whole.decode(whole.infer(whole.encode(picture)))["boxes"].array[0]
        raw = parted.decode(parted.infer(parted.encode(picture)))["boxes"].values()[0]
        ours = decode_anchored(raw, anchors, (10.0, 10.0, 5.0, 5.0))
        for y0, x0, y1, x1 in theirs:
            assert np.abs(ours - [x0, y0, x1, y1]).max(axis=1).min() < 1e-6
