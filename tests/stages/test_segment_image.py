from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from accelerators.litert import TfliteCpu
from accelerators.registry import Registry
from pipeline.errors import ModelError, StageError
from pipeline.message import Message
from pipeline.model import ModelSpec, Tensor
from stages.kernels.sampling import sample_scores
from stages.segment_image import SegmentImage, Tiling
from stages.taxonomy import load_taxonomy
from stages.types import CHANNELS, PADDING_LOG, ClassScores, Image

TAXONOMY = load_taxonomy()


def opened(head: dict[str, Any], shape: tuple[int, int, int] = (9, 9, 3), **options: Any) -> Any:
    stage = SegmentImage(**options)
    stage.model = ModelSpec("net", "image", shape, "uint8", "rgb", {"class_map": {}, **head})
    stage.open()
    return stage


def photo(width: int, height: int) -> Message[Image]:
    noise = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    return Message.at(5, Image(noise, "front"))


def labels_of(scores: ClassScores) -> Any:
    """The best class of every pixel of the full-resolution image."""
    width, height = scores.size
    v, u = np.mgrid[:height, :width].astype(np.float32)
    rows, _ = sample_scores(
        scores.grid,
        scores.rects,
        scores.scale,
        float(scores.zero_point),
        np.stack([u.ravel(), v.ravel()], axis=1),
        len(TAXONOMY),
    )
    return rows[:, : len(TAXONOMY)].argmax(axis=1).reshape(height, width)


def test_scores_in_our_channels_stay_quantized_and_uncopied() -> None:
    stage = opened({"kind": "scores", "align_corners": True}, temperature=2.0)
    grid = np.zeros((1, 3, 4, CHANNELS), dtype=np.int8)
    image = photo(20, 10)
    found = stage.finish({"scores": Tensor(grid, 0.1, 3)}, image)
    assert found.grid is grid
    assert (found.scale, found.zero_point) == (0.05, 3)
    assert (found.camera, found.size) == ("front", (20, 10))


def test_scores_of_a_network_one_pixel_larger_than_the_image_lie_on_every_eighth_pixel() -> None:
    stage = opened({"kind": "scores", "align_corners": True}, shape=(17, 25, 3))
    image = photo(24, 16)
    picture = stage.prepare(image)["image"].array[0]
    np.testing.assert_array_equal(picture[:16, :24], image.payload.data)
    grid = np.zeros((1, 3, 4, CHANNELS), dtype=np.float32)
    grid[0, :, :, 0], grid[0, :, :, 1] = np.meshgrid(np.arange(4), np.arange(3))
    found = stage.finish({"scores": Tensor(grid)}, image)
    pixel = np.array([[0, 0], [8, 8], [16, 0], [12, 4]], np.float32)
    rows, covered = sample_scores(found.grid, found.rects, 1.0, 0.0, pixel, 2)
    assert covered.all()
    np.testing.assert_allclose(rows[:, :2], [[0, 0], [1, 1], [2, 0], [1.5, 0.5]], atol=1e-6)


def test_classes_of_the_network_become_ours() -> None:
    head = {"kind": "scores", "class_map": {0: "road", 1: "sidewalk", 2: "road"}}
    logits = np.array([[[[1.0, 3.0, 2.5]]]], dtype=np.float32)
    found = opened(head).finish({"scores": Tensor(logits)}, photo(4, 4))
    p = np.exp([1.0, 3.0, 2.5]) / np.exp([1.0, 3.0, 2.5]).sum()
    row = found.grid[0, 0, 0]
    assert row[TAXONOMY.id("road")] == pytest.approx(np.log(p[0] + p[2]), abs=1e-5)
    assert row[TAXONOMY.id("sidewalk")] == pytest.approx(np.log(p[1]), abs=1e-5)
    assert row[TAXONOMY.id("water")] == pytest.approx(np.log(1e-6), abs=1e-4)
    assert (row[len(TAXONOMY) :] == PADDING_LOG).all()
    assert found.scale == 1.0


def test_a_label_map_is_sampled_at_its_stride() -> None:
    head = {
        "kind": "label_map",
        "classes": 3,
        "confidence": 0.8,
        "stride": 4,
        "align_corners": True,
        "class_map": {0: "road", 1: "person", 2: "sky"},
    }
    labels = np.zeros((1, 9, 9), dtype=np.int64)
    labels[0, 4, 8] = 1
    found = opened(head).finish({"labels": Tensor(labels)}, photo(9, 9))
    assert found.grid.shape == (1, 3, 3, CHANNELS)
    best = found.grid[..., : len(TAXONOMY)].argmax(axis=-1)[0]
    assert best[1, 2] == TAXONOMY.id("person")
    assert (np.delete(best.ravel(), 5) == TAXONOMY.id("road")).all()
    assert found.grid[0, 1, 2, TAXONOMY.id("person")] == pytest.approx(np.log(0.8), abs=1e-5)
    assert found.grid[0, 1, 2, TAXONOMY.id("sky")] == pytest.approx(np.log(0.1), abs=1e-5)


def test_tiles_are_spread_from_edge_to_edge_as_the_recipe_says() -> None:
    stage = opened({"kind": "scores"}, tiles=[Tiling(1.0, 4), Tiling(1.387, 3)])
    image = photo(1242, 375)
    assert stage.prepare(image)["image"].array.shape == (7, 9, 9, 3)
    grid = np.zeros((7, 2, 2, CHANNELS), dtype=np.int8)
    rects = stage.finish({"scores": Tensor(grid)}, image).rects
    assert rects[:4, 0].tolist() == [0, 289, 578, 867]
    assert rects[4:, 0].tolist() == [0, 361, 722]
    assert (rects[:, 2] - rects[:, 0]).tolist() == [375] * 4 + [520] * 3
    assert rects[-1, 2] == 1242


def test_a_tile_is_never_wider_than_the_image() -> None:
    stage = opened({"kind": "scores"}, tiles=[Tiling(3.0, 1)])
    found = stage.finish({"scores": Tensor(np.zeros((1, 2, 2, CHANNELS), np.int8))}, photo(10, 8))
    assert found.rects.tolist() == [[0, 0, 10, 8]]


def test_exposures_of_one_tile_are_averaged_as_logits() -> None:
    stage = opened({"kind": "scores"}, tiles=[Tiling(1.0, 2)], gammas=[1.0, 0.5])
    pictures = stage.prepare(photo(20, 9))["image"].array
    assert pictures.shape == (4, 9, 9, 3)
    assert (pictures[1] >= pictures[0]).all()
    assert (pictures[1] > pictures[0]).any()
    grid = np.arange(4, dtype=np.int8)[:, None, None, None] * np.ones((2, 2, CHANNELS), np.int8)
    found = stage.finish({"scores": Tensor(grid, 2.0, 1)}, photo(20, 9))
    assert found.grid[:, 0, 0, 0].tolist() == [(0.5 - 1) * 2, (2.5 - 1) * 2]


def test_a_frame_of_the_networks_size_is_passed_on_uncopied() -> None:
    image = photo(9, 9)
    tensors = opened({"kind": "scores"}).prepare(image)
    assert np.shares_memory(tensors["image"].array, image.payload.data)


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ({"kind": "fastestdet"}, "SegmentImage takes 'scores' or 'label_map'"),
        ({"kind": "scores", "class_map": {0: "raod"}}, "no class 'raod'; did you mean 'road'"),
    ],
)
def test_a_model_that_does_not_fit_is_refused(head: dict[str, Any], said: str) -> None:
    with pytest.raises(ModelError, match=said):
        opened(head)


def test_unmapped_channels_of_another_count_are_refused() -> None:
    stage = opened({"kind": "scores"})
    with pytest.raises(ModelError, match="has 19 channels; without a class_map it needs"):
        stage.finish({"scores": Tensor(np.zeros((1, 2, 2, 19), np.int8))}, photo(4, 4))


def test_16_bit_images_are_refused_with_the_way_out() -> None:
    raw = Message.at(0, Image(np.zeros((4, 4), np.uint16), "thermal"))
    with pytest.raises(StageError, match="camera 'thermal' gives uint16 images, networks take"):
        opened({"kind": "scores"}).prepare(raw)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"temperature": 0.0}, "temperature must be above 0"),
        ({"gammas": []}, "one or more numbers above 0"),
        ({"tiles": [Tiling(1.0, 0)]}, "an aspect and a count above 0"),
    ],
)
def test_a_bad_option_is_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        SegmentImage(**options)


def test_the_registry_and_the_taxonomy_map_cityscapes_alike() -> None:
    head = Registry.open().spec("segment-rgb-cityscapes").head
    ours = TAXONOMY.label_map("cityscapes").tolist()
    assert {theirs: TAXONOMY.id(name) for theirs, name in head["class_map"].items()} == dict(
        enumerate(ours)
    )


@pytest.mark.parametrize("name", ["segment-rgb-cityscapes", "segment-rgb-cityscapes-labels"])
def test_the_public_network_labels_its_street_photo(shared: Path, name: str) -> None:
    """0.921 of the pixels agree with the mask that comes with the network."""
    folder = shared / "models" / "coral"
    bgr = cv2.imread(str(folder / "cityscapes_segmentation.bmp"))
    mask = cv2.imread(str(folder / "cityscapes_segmentation_mask.bmp"), cv2.IMREAD_GRAYSCALE)
    image = Message.at(0, Image(np.ascontiguousarray(bgr[..., ::-1]), "photo"))
    model = Registry.open().load(name, TfliteCpu())
    found = labels_of(SegmentImage().run_once(image, model=model))
    agree = found == TAXONOMY.translate("cityscapes", mask)
    assert agree.mean() > 0.915


@pytest.mark.slow
def test_tiles_find_the_street_that_the_squeezed_image_loses(shared: Path) -> None:
    """Frame 22 of the half-size drive, looked at: a facade, tram tracks, the nearest car."""
    bgr = cv2.imread(str(shared / "data" / "kitti_drive_lite108" / "image" / "022.png"))
    image = Message.at(0, Image(np.ascontiguousarray(bgr[..., ::-1]), "camera"))
    model = Registry.open().load("segment-rgb-cityscapes", TfliteCpu())
    tiles = [Tiling(1.0, 4), Tiling(1.387, 3)]
    tiled = labels_of(SegmentImage(tiles=tiles, gammas=[0.6]).run_once(image, model=model))
    squeezed = labels_of(SegmentImage(gammas=[0.6]).run_once(image, model=model))
    facade, tracks, car = np.s_[50:85, 10:95], np.s_[140:180, 430:600], np.s_[105:130, 20:110]
    assert (tiled[facade] == TAXONOMY.id("building")).mean() > 0.95
    assert (tiled[tracks] == TAXONOMY.id("road")).mean() > 0.95
    assert (tiled[car] == TAXONOMY.id("vehicle")).mean() > 0.9
    assert (squeezed[tracks] == TAXONOMY.id("road")).mean() < 0.6
    assert (squeezed[car] == TAXONOMY.id("vehicle")).mean() < 0.1
