"""What needs no network: height rules, and labels inside boxes that people drew."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import DataError
from tools.tables.drive_boxes import judge_boxes
from tools.tables.rules import by_height, height_above_ground, rules

ROAD, VEGETATION, VEHICLE, BUILDING = 3, 7, 13, 1


def test_heights_are_above_a_tilted_road() -> None:
    random = np.random.default_rng(0)
    road = random.uniform(-20, 20, (3000, 2))
    z = -1.73 + 0.05 * road[:, 0]
    hedge = random.uniform([5, 5], [9, 9], (500, 2))
    points = np.concatenate(
        [np.column_stack([road, z]), np.column_stack([hedge, 0.05 * hedge[:, 0] - 0.73])]
    )
    height = height_above_ground(points.astype(np.float32))
    np.testing.assert_allclose(height[:3000], 0, atol=0.03)
    np.testing.assert_allclose(height[3000:], 1.0, atol=0.03)


def test_a_rule_names_a_class_for_every_height() -> None:
    rule = rules()["road below 0.25 m, vehicle, vegetation, building"]
    heights = np.array([-0.1, 0.24, 0.26, 1.7, 9.0])
    assert by_height(heights, rule).tolist() == [ROAD, ROAD, VEHICLE, VEGETATION, BUILDING]
    assert len(rules()) == 10


def annotation(folder: Path) -> Path:
    """A car of 4 x 2 x 1.5 m at (10, 0), turned by 90 degrees, in frame 1; and a tram."""
    figure = {
        "objectKey": "car",
        "geometry": {
            "position": {"x": 10, "y": 0, "z": -1.0},
            "dimensions": {"x": 4, "y": 2, "z": 1.5},
            "rotation": {"x": 0, "y": 0, "z": np.pi / 2},
        },
    }
    content = {
        "objects": [{"key": "car", "classTitle": "Car"}, {"key": "t", "classTitle": "Tram"}],
        "frames": [
            {"index": 0, "figures": []},
            {"index": 1, "figures": [figure, figure | {"objectKey": "t"}]},
        ],
    }
    (folder / "boxes.json").write_text(json.dumps(content))
    return folder / "boxes.json"


def test_points_in_car_boxes_and_above_the_road_count(tmp_path: Path) -> None:
    road = np.array([[9.5, y, -1.73] for y in np.linspace(-3, 3, 40)])
    car = np.array([[10.0, 1.8, -1.0], [10.0, -1.8, -1.0], [10.5, 0, -0.5], [10.0, 0, -1.6]])
    beside = np.array([[11.8, 0, -1.0], [10, 2.2, -1.0]])
    points = np.concatenate([road, car, beside]).astype(np.float32)
    labels = np.zeros(len(points), np.uint8)
    labels[40:43] = [VEHICLE, BUILDING, 0]
    labels[43:] = VEHICLE
    verdict = judge_boxes(annotation(tmp_path), lambda frame: (points, labels), VEHICLE)
    assert (verdict.points, verdict.labeled, verdict.vehicle) == (3, 2, 1)
    assert verdict.labeled_share == pytest.approx(2 / 3)
    assert verdict.vehicle_share == 0.5


def test_another_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "b.json").write_text("{}")
    with pytest.raises(DataError, match=r"b\.json: is no annotation of boxes"):
        judge_boxes(tmp_path / "b.json", lambda _: (np.zeros((0, 3)), np.zeros(0)), 13)  # type: ignore[arg-type,return-value]
