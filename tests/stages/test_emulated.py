from __future__ import annotations

import numpy as np
import pytest

from accelerators.emulated import Emulated
from accelerators.registry import Registry
from pipeline.message import Message
from pipeline.model import BoundModel
from stages.detect import DetectObjects
from stages.emulated import DETECTED, SCORE, StreetNetworks
from stages.emulated_street import painted, painted_gray
from stages.segment_image import SegmentImage
from stages.segment_scan import SegmentScan
from stages.sources.emulated import EmulatedLidar
from stages.taxonomy import load_taxonomy
from stages.types import Image

TAXONOMY = load_taxonomy()


def network(name: str) -> BoundModel:
    return Registry.open().load(name, Emulated(latency_ms={name: 0}, outputs=StreetNetworks()))


def scene(height: int, width: int) -> np.ndarray:
    label = np.full((height, width), TAXONOMY.id("road"), np.uint8)
    label[:160] = TAXONOMY.id("sky")
    label[200:304, 400:440] = TAXONOMY.id("person")
    label[200:240, 80:160] = TAXONOMY.id("vehicle")
    label[200:240, 200:280] = TAXONOMY.id("vehicle")
    return label


def test_a_segmentation_says_the_class_that_is_painted_at_each_cell() -> None:
    label = scene(480, 848)
    found = SegmentImage().run_once(
        Message.at(0, Image(painted(label), "rgb")), model=network("segment-rgb")
    )
    assert found.grid.shape == (1, 61, 107, 16)
    best = found.grid[0, ..., :15].argmax(axis=-1)
    np.testing.assert_array_equal(best[:60, :106], label[::8, ::8])
    assert found.grid.max() * found.scale == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("name", "size"), [("detect-rgb", (480, 848)), ("detect-thermal", (512, 640))]
)
def test_a_detector_boxes_every_patch_of_its_classes(name: str, size: tuple[int, int]) -> None:
    label = scene(*size)
    pixels = painted(label) if name == "detect-rgb" else painted_gray(label)
    found = DetectObjects().run_once(Message.at(0, Image(pixels, "c")), model=network(name))
    by_left = np.argsort(found.boxes[:, 0])
    assert [TAXONOMY.names[number] for number in found.classes[by_left]] == [
        "vehicle",
        "vehicle",
        "person",
    ]
    expected = [[80, 200, 160, 240], [200, 200, 280, 240], [400, 200, 440, 304]]
    np.testing.assert_allclose(found.boxes[by_left], expected, atol=1e-3)
    np.testing.assert_allclose(found.scores, SCORE, atol=1e-3)


def test_more_patches_than_rows_are_left_out() -> None:
    label = np.zeros((480, 848), np.uint8)
    label[4::16, 4::16] = 0
    for row in range(0, 480, 16):
        for column in range(0, 848, 16):
            label[row : row + 8, column : column + 8] = TAXONOMY.id("vehicle")
    found = DetectObjects().run_once(
        Message.at(0, Image(painted(label), "c")), model=network("detect-rgb")
    )
    assert len(found.boxes) == 100


def test_a_scan_gets_the_classes_of_what_it_hit() -> None:
    source = EmulatedLidar(count=1)
    source.open()
    scan = next(source.messages())
    found = SegmentScan().run_once(scan, model=network("segment-scan"))
    hit = np.linalg.norm(found.points, axis=1) > 0
    assert not found.evidence[~hit].any()
    assert found.evidence[hit].mean() > 0.99
    best = found.log_scores[:, : len(TAXONOMY)].argmax(axis=1)
    ground = hit & (found.points[:, 2] < -3.95)
    assert np.isin(best[ground], [TAXONOMY.id("road"), TAXONOMY.id("sidewalk")]).mean() > 0.95
    assert {TAXONOMY.names[number] for number in np.unique(best[hit])} >= {*DETECTED, "building"}


def test_its_answers_come_in_the_time_of_the_emulated_device_and_say_what_they_are() -> None:
    device = Emulated(latency_ms={}, outputs=StreetNetworks())
    assert device.kinds == ("emulated",)
    assert "emulated street" in device.probe().runtime
