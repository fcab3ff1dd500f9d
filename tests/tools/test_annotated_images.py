from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pipeline.errors import DataError
from stages.taxonomy import load_taxonomy
from tools.annotated_images import read_annotated


def coco(folder: Path, **changes: Any) -> Path:
    """A folder of one image with a person, a dog, a crowd and a region that nobody may judge."""
    folder.mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "a.png"), np.zeros((48, 64), np.uint8))
    names = {1: "Person", 2: "dog", 3: "DontCare", 4: "car"}
    rows = [(1, 0), (2, 0), (3, 0), (4, 1)]
    content: dict[str, Any] = {
        "images": [{"id": 7, "file_name": "a.png", "width": 64, "height": 48}],
        "categories": [{"id": number, "name": name} for number, name in names.items()],
        "annotations": [
            {"image_id": 7, "category_id": kind, "bbox": [4, 5, 10, 20], "iscrowd": crowd}
            for kind, crowd in rows
        ],
    }
    (folder / "ann.json").write_text(json.dumps(content | changes))
    return folder


def test_categories_become_our_classes_and_the_rest_is_left_out(tmp_path: Path) -> None:
    (image,) = read_annotated(coco(tmp_path))
    assert image.classes.tolist() == [load_taxonomy().id("person"), -1, -1]
    assert image.ignored.tolist() == [False, True, True]
    assert image.boxes[0].tolist() == [4, 5, 14, 25]
    assert image.size == (64, 48)


def test_boxes_with_a_short_side_can_be_left_out_of_the_judgment(tmp_path: Path) -> None:
    (image,) = read_annotated(coco(tmp_path))
    assert image.without_small(10).classes.tolist() == image.classes.tolist()
    assert image.without_small(10.5).ignored.tolist() == [True, True, True]


def test_a_folder_without_annotations_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"holds no ann\.json or .*COCO annotations"):
        read_annotated(tmp_path)


def test_an_annotation_of_no_image_is_told(tmp_path: Path) -> None:
    folder = coco(tmp_path, images=[])
    with pytest.raises(DataError, match="no COCO annotation file"):
        read_annotated(folder)


def test_a_missing_image_is_named(tmp_path: Path) -> None:
    folder = coco(tmp_path)
    (folder / "a.png").unlink()
    with pytest.raises(DataError, match=r"has no image a\.png"):
        read_annotated(folder)


def test_the_shared_sets_hold_what_their_description_says(shared: Path) -> None:
    taxonomy = load_taxonomy()
    images = read_annotated(shared / "data" / "hit_uav")
    counts = {
        name: sum(int((image.classes == taxonomy.id(name)).sum()) for image in images)
        for name in ("person", "vehicle", "bicycle")
    }
    assert counts == {"person": 432, "vehicle": 78, "bicycle": 116}
    assert sum(int(image.ignored.sum()) for image in images) == 3


@pytest.mark.parametrize(
    ("annotations", "name", "image"),
    [
        ("annotations/instances_val2017.json", "a.png", "val2017/a.png"),  # COCO
        ("annotations/instances_train2017.json", "a.png", "train2017/a.png"),
        ("thermal_annotations.json", "thermal_8_bit/a.png", "thermal_8_bit/a.png"),  # FLIR ADAS 1
        ("coco.json", "data/a.png", "data/a.png"),  # FLIR ADAS 2
    ],
)
def test_the_layouts_of_coco_and_flir_adas_are_known(
    annotations: str, name: str, image: str, tmp_path: Path
) -> None:
    coco(tmp_path)
    for file in (annotations, image):
        (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / "a.png").rename(tmp_path / image)
    content = json.loads((tmp_path / "ann.json").read_text())
    content["images"][0]["file_name"] = name
    content["categories"] = [
        {"id": 1, "name": "bike"}, {"id": 2, "name": "motor"},
        {"id": 3, "name": "other vehicle"}, {"id": 4, "name": "dog"},
    ]  # fmt: skip
    (tmp_path / "ann.json").unlink()
    (tmp_path / annotations).write_text(json.dumps(content))
    (found,) = read_annotated(tmp_path)
    taxonomy = load_taxonomy()
    ours = [taxonomy.id("bicycle"), taxonomy.id("bicycle"), taxonomy.id("vehicle")]
    assert found.classes.tolist() == ours
    assert found.path == tmp_path / image
    found.path.unlink()
    with pytest.raises(DataError, match=r"has no image .*a\.png, which its annotations name"):
        read_annotated(tmp_path)


@pytest.mark.parametrize(
    "annotations",
    ["annotations/instances_train2017.json", "thermal_annotations.json", "coco.json"],
)
@pytest.mark.parametrize(
    ("broken", "said"),
    [
        (lambda text: text[: len(text) // 2], "is no COCO annotation file"),  # cut short
        (lambda text: text.replace('"bbox"', '"segmentation"'), "is no COCO annotation file"),
        (lambda text: text.replace("[4, 5, 10, 20]", "[4, 5]"), "is no COCO annotation file"),
        (lambda text: text.replace('"category_id": 1', '"category_id": 99'), "KeyError 99"),
        (lambda text: "[]", "is no COCO annotation file"),
    ],
)
def test_a_broken_annotation_file_of_coco_and_flir_adas_is_named(
    annotations: str, broken: Callable[[str], str], said: str, tmp_path: Path
) -> None:
    coco(tmp_path)
    text = (tmp_path / "ann.json").read_text()
    (tmp_path / "ann.json").unlink()
    (tmp_path / annotations).parent.mkdir(exist_ok=True)
    (tmp_path / annotations).write_text(broken(text))
    with pytest.raises(DataError, match=said) as error:
        read_annotated(tmp_path)
    assert str(tmp_path / annotations) in str(error.value)


def test_an_image_that_is_cut_short_is_named_when_it_is_read(tmp_path: Path) -> None:
    (image,) = read_annotated(coco(tmp_path))
    image.path.write_bytes(image.path.read_bytes()[:20])
    with pytest.raises(DataError, match=r"a\.png: is no picture that can be read"):
        image.read()
