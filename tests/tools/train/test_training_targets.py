"""What a network is taught, read back by the heads that will read what it says."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

torch = pytest.importorskip("torch", reason="the extra 'train' is not installed")

from pipeline.model import Tensor  # noqa: E402
from stages.heads.centernet import CenterNet as CenterNetHead  # noqa: E402
from stages.heads.ssd import Ssd as SsdHead  # noqa: E402
from stages.kernels.anchors import SMALL_OBJECTS, multiscale_anchors  # noqa: E402
from tools.train.center_loss import center_loss, generalized_iou  # noqa: E402
from tools.train.center_net import CenterNet  # noqa: E402
from tools.train.center_targets import center_targets  # noqa: E402
from tools.train.crops import Augmentation, Crop, Crops  # noqa: E402
from tools.train.pictures import LabeledPicture  # noqa: E402
from tools.train.recipes import DETECT_RGB, DETECT_THERMAL, DetectorRecipe  # noqa: E402
from tools.train.residual_backbone import ResidualBackbone  # noqa: E402
from tools.train.ssd import Ssd, match_anchors  # noqa: E402

SIDE = 128
BOXES = np.array([[20, 30, 34, 60], [70, 70, 118, 100], [4, 90, 15, 99]], np.float32)
CLASSES = np.array([0, 1, 2])


def crop(classes: NDArray[np.int64] = CLASSES) -> Crop:
    return Crop(np.zeros((SIDE, SIDE, 1), np.uint8), BOXES, classes)


def as_said(targets: dict[str, NDArray[np.float32]]) -> dict[str, Tensor]:
    """Outputs (1, h, w, k) of a network that says exactly what it was taught."""
    boxes = targets["boxes"]
    rows, columns = boxes.shape[1:]
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    size = np.log(np.maximum(boxes[2:] - boxes[:2], 1e-3))
    offset = (boxes[2:] + boxes[:2]) / 2 - np.stack((x, y))
    heat = np.clip(targets["heat"], 1e-4, 1 - 1e-4)
    logits = np.log(heat / (1 - heat))
    return {
        name: Tensor(np.ascontiguousarray(one.transpose(1, 2, 0)[None], dtype=np.float32))
        for name, one in (("heat", logits), ("size", size), ("offset", offset))
    }


def test_the_centernet_head_reads_the_boxes_that_were_taught() -> None:
    targets = center_targets(crop(), 3)
    settings = CenterNet(ResidualBackbone(1), 3).registry_head()
    head = CenterNetHead(class_map={0: "person", 1: "vehicle", 2: "bicycle"}, **settings)
    said = as_said({"heat": targets.heat, "boxes": targets.boxes})
    boxes, classes, scores = head.decoder((SIDE, SIDE), 0.9)(said)
    order = np.argsort(classes)
    assert classes[order].tolist() == [0, 1, 2]
    assert np.allclose(boxes[order] * SIDE, BOXES, atol=1e-2)
    assert (scores > 0.99).all()


def test_each_object_weighs_as_much_as_another() -> None:
    targets = center_targets(crop(), 3)
    assert targets.weight.sum() == pytest.approx(3, abs=1e-4)


def test_nothing_is_learned_where_an_object_is_hidden() -> None:
    targets = center_targets(crop(np.array([0, -1, 2])), 3)
    assert targets.heat[1].max() == 0
    assert (targets.counted[0, 18:25, 18:29] == 0).all()
    assert targets.weight.sum() == pytest.approx(2, abs=1e-4)


def test_the_loss_falls_as_an_answer_nears_what_was_taught() -> None:
    targets = center_targets(crop(), 3)
    batch = {
        name: torch.from_numpy(getattr(targets, name)[None])
        for name in ("heat", "counted", "boxes", "weight")
    }
    said = as_said({"heat": targets.heat, "boxes": targets.boxes})
    right = {name: torch.from_numpy(one.array).movedim(3, 1) for name, one in said.items()}
    wrong = {name: one + 0.7 for name, one in right.items()}
    best, worse = (sum(center_loss(one, batch).values()) for one in (right, wrong))
    assert float(center_loss(right, batch)["box"]) == pytest.approx(0, abs=1e-3)
    assert best < worse


def test_generalized_iou_is_that_of_its_definition() -> None:
    one = torch.tensor([[0.0, 0.0, 2.0, 2.0], [0.0, 0.0, 1.0, 1.0]])
    other = torch.tensor([[1.0, 0.0, 3.0, 2.0], [2.0, 0.0, 3.0, 1.0]])
    assert generalized_iou(one, other).tolist() == pytest.approx([1 / 3, -1 / 3])


def test_the_ssd_head_reads_the_boxes_that_were_taught() -> None:
    anchors = multiscale_anchors(*SMALL_OBJECTS, (SIDE, SIDE)) * SIDE
    labels, regressions = match_anchors(crop(), anchors)
    logits = np.full((1, len(anchors), 3), -9.0, np.float32)
    taught = np.flatnonzero(labels >= 0)
    logits[0, taught, labels[taught]] = 9.0
    settings = Ssd(ResidualBackbone(1), 3).registry_head()
    head = SsdHead(class_map={0: "person", 1: "vehicle", 2: "bicycle"}, **settings)
    said = {"boxes": Tensor(regressions[None]), "scores": Tensor(logits)}
    boxes, classes, _ = head.decoder((SIDE, SIDE), 0.9)(said)
    assert set(classes.tolist()) == {0, 1, 2}
    for box, label in zip(boxes, classes, strict=True):
        assert np.allclose(box * SIDE, BOXES[label], atol=0.05)


def picture() -> LabeledPicture:
    pixels = np.zeros((200, 300), np.uint8)
    pixels[50:80, 100:120] = 255
    return LabeledPicture(pixels, np.array([[100, 50, 120, 80]], np.float32), np.array([5]))


def test_a_crop_carries_its_boxes_along() -> None:
    plain = Augmentation(contrast=(1, 1), gamma=(1, 1), brightness=0, noise=0, around_object=1)
    crops = Crops([picture()], [5], [1.0], side=96, augmentation=plain)
    seen = 0
    for seed in range(40):
        drawn = crops.draw(np.random.default_rng(seed))
        whole = [box for box, label in zip(drawn.boxes, drawn.classes, strict=True) if label == 0]
        for x0, y0, x1, y1 in (np.rint(box).astype(int) for box in whole):
            seen += 1
            inside = drawn.pixels[y0 + 1 : y1 - 1, x0 + 1 : x1 - 1]
            assert inside.mean() > 235
            assert drawn.pixels.sum() < 1.3 * 255 * (y1 - y0) * (x1 - x0)
    assert seen > 20


def test_the_same_random_state_draws_the_same_crop() -> None:
    crops = Crops([picture()], [5], [1.0], side=64)
    one, other = (crops.draw(np.random.default_rng([3, 4])) for _ in range(2))
    assert np.array_equal(one.pixels, other.pixels)
    assert np.array_equal(one.boxes, other.boxes)


@pytest.mark.parametrize("recipe", [DETECT_RGB, DETECT_THERMAL], ids=lambda one: str(one.name))
def test_a_crop_fits_into_the_image_and_divides_into_the_cells_of_every_level(
    recipe: DetectorRecipe,
) -> None:
    assert recipe.side % 32 == 0
    assert recipe.side / recipe.augmentation.zoom[0] <= min(recipe.size)
