from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from accelerators.registry import Registry
from pipeline.errors import ModelError
from tools.annotated_images import read_annotated
from tools.evaluate_detections import judge, open_model, summary
from tools.main import app

KINDS = ("tflite", "openvino")


def annotated(folder: Path) -> Path:
    """Two dark frames; a person was annotated in each, where there is nothing to see."""
    folder.mkdir()
    for number in range(2):
        cv2.imwrite(str(folder / f"{number}.png"), np.full((512, 640), 90, np.uint8))
    content = {
        "images": [
            {"id": number, "file_name": f"{number}.png", "width": 640, "height": 512}
            for number in range(2)
        ],
        "categories": [{"id": 1, "name": "person"}],
        "annotations": [
            {"image_id": number, "category_id": 1, "bbox": [100, 100, 20, 40]}
            for number in range(2)
        ],
    }
    (folder / "ann.json").write_text(json.dumps(content))
    return folder


@pytest.mark.parametrize("kind", KINDS)
def test_the_shipped_thermal_detector_finds_nothing_where_nothing_is(
    kind: str, tmp_path: Path
) -> None:
    bound, _ = open_model(Registry.open(), "detect-thermal", kind)
    verdict = summary(judge(bound, read_annotated(annotated(tmp_path / "data")), min_iou=0.5))
    assert verdict["classes"]["person"] == {
        "objects": 2,
        "ap": 0.0,
        "interval": [0.0, 0.0],
        "recall": 0.0,
        "precision": None,
    }
    assert verdict["classes"]["vehicle"]["ap"] is None


def test_the_command_prints_and_draws(tmp_path: Path) -> None:
    data, pictures = annotated(tmp_path / "data"), tmp_path / "pictures"
    words = ["evaluate-detections", "detect-thermal", "--images", str(data)]
    words += ["--pictures", str(pictures)]
    shown = CliRunner().invoke(app, words)
    assert shown.exit_code == 0, shown.output
    assert "AP50" in shown.stdout
    drawn = cv2.imread(str(pictures / "1.png"))
    assert drawn[100, 110].tolist() == [255, 255, 255]  # the edge of the annotated box
    told = json.loads(CliRunner().invoke(app, [*words, "--json"]).stdout)
    assert told["images"] == 2


def test_a_model_without_a_file_of_that_kind_is_told() -> None:
    with pytest.raises(ModelError, match="'detect-thermal' has no onnx to be judged; it has tfl"):
        open_model(Registry.open(), "detect-thermal", "onnx")


@pytest.mark.parametrize("kind", KINDS)
def test_the_shipped_thermal_detector_sees_real_people_and_cars(kind: str, shared: Path) -> None:
    images = read_annotated(shared / "data" / "hit_uav")[-6:]
    bound, _ = open_model(Registry.open(), "detect-thermal", kind)
    verdict = summary(judge(bound, images, min_iou=0.5))
    assert verdict["classes"]["vehicle"]["ap"] > 0.5
    assert verdict["classes"]["person"]["ap"] > 0.5


def test_the_shipped_weights_are_small_and_have_their_card(root: Path) -> None:
    folder = root / "graphs" / "models"
    for file in folder.glob("detect-thermal*"):
        assert file.stat().st_size < 5_000_000
    card = (folder / "cards" / "detect-thermal.md").read_text()
    for words in ("CC BY 4.0", "HIT-UAV", "overflight train detect-thermal", "int8"):
        assert words in card
