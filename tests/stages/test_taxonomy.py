"""The shipped classes and maps, and what a wrong taxonomy file says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import DataError
from stages.taxonomy import load_taxonomy


def test_the_shipped_classes_are_the_fifteen_of_the_paper_s_group() -> None:
    taxonomy = load_taxonomy()
    assert len(taxonomy) == 15
    assert taxonomy.names[0] == "background"
    assert taxonomy.colors[taxonomy.id("vehicle")].tolist() == [129, 0, 127]
    dynamic = [name for name, moves in zip(taxonomy.names, taxonomy.dynamic, strict=True) if moves]
    assert dynamic == ["person", "rider", "bicycle", "train", "vehicle"]
    ground = [name for name, flat in zip(taxonomy.names, taxonomy.ground, strict=True) if flat]
    assert ground == ["road", "sidewalk", "vegetation"]
    assert len(np.unique(taxonomy.colors, axis=0)) == 15


@pytest.mark.parametrize(
    ("label_set", "labels"),
    [("cityscapes", 19), ("mapillary", 66), ("semantickitti_learning", 20), ("carla", 23)],
)
def test_a_map_covers_its_whole_label_set(label_set: str, labels: int) -> None:
    ours = load_taxonomy().label_map(label_set)
    assert len(ours) == labels
    assert (ours >= 0).all()


def test_labels_translate_and_unknown_ones_have_no_counterpart() -> None:
    taxonomy = load_taxonomy()
    ids = np.array([1, 3, 44, -1, 91])
    expected = [taxonomy.id("person"), taxonomy.id("vehicle"), -1, -1, -1]
    assert taxonomy.translate("coco", ids).tolist() == expected
    raw = taxonomy.translate("semantickitti", np.array([252, 40, 99, 100]))
    assert raw.tolist() == [taxonomy.id("vehicle"), taxonomy.id("road"), 0, -1]


def test_a_wrong_name_is_answered_with_the_nearest() -> None:
    taxonomy = load_taxonomy()
    with pytest.raises(ValueError, match="no class 'vehicel'; did you mean 'vehicle'"):
        taxonomy.id("vehicel")
    with pytest.raises(ValueError, match="no label set 'cityscape'; did you mean 'cityscapes'"):
        taxonomy.label_map("cityscape")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("classes: 3", "not a taxonomy"),
        ("classes: [{name: a}]\nmaps: {}", "not a taxonomy"),
        ("[", "not a taxonomy"),
        ("classes: []\nmaps: {}", "0 classes; from 1 to 16 fit"),
        ("classes: [{name: a, color: [0, 0, 0]}]\nmaps: {m: {b: [1]}}", "maps.m: no class 'b'"),
        (
            "classes: [{name: a, color: [0, 0, 0]}, {name: b, color: [1, 0, 0]}]\n"
            "maps: {m: {a: [1], b: [1]}}",
            "maps.m: an id stands in two classes",
        ),
    ],
)
def test_a_wrong_file_says_what_is_wrong(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "taxonomy.yaml"
    path.write_text(text)
    with pytest.raises(DataError, match=message):
        load_taxonomy(path)
