"""Overlays, looked at by the pixel."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.message import Message
from stages.sinks.png_overlay import PngOverlay
from stages.taxonomy import load_taxonomy
from stages.types import Calibration, ClassScores, Cloud, Detections, Image, Pose

COLORS = load_taxonomy().colors
CALIBRATION = Calibration.parse(
    {
        "lidar": {"base_from_sensor": np.eye(4).tolist()},
        "rgb": {
            "base_from_sensor": [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0]],
            "camera": {"size": [100, 80], "fx": 50, "fy": 50, "cx": 50, "cy": 40},
        },
    }
)


def image(stamp: int = 0, data: np.ndarray | None = None) -> Message[Image]:
    gray = np.full((80, 100, 3), 100, np.uint8)
    return Message.at(stamp, Image(gray if data is None else data, "rgb"))


def drawn(path: Path) -> np.ndarray:
    (file,) = path.glob("*.png")
    picture = cv2.imread(str(file))
    assert picture is not None
    return picture[..., ::-1]


def test_classes_are_laid_over_the_image(tmp_path: Path) -> None:
    grid = np.zeros((1, 4, 4, 16), np.float32)
    grid[0, :2, :, 7] = grid[0, 2:, :, 3] = 4.0
    rects = np.array([[0, 0, 100, 80]], np.float32)
    scores = Message.at(0, ClassScores(grid, rects, 1.0, 0, "rgb", (100, 80)))
    PngOverlay(folder=tmp_path, share=1.0).run_once(image(), scores)
    picture = drawn(tmp_path)
    assert (picture[5:35] == COLORS[7]).all()
    assert (picture[45:] == COLORS[3]).all()


def test_points_are_drawn_where_the_camera_saw_them_at_its_own_stamp(tmp_path: Path) -> None:
    log_scores = np.zeros((2, 16), np.float32)
    log_scores[:, 5] = 4.0
    points = np.array([[10, 2, 0], [10, -2, 0]], np.float32)
    cloud = Cloud(points, log_scores, np.array([True, False]), np.eye(4), "lidar")
    nearer = np.eye(4)
    nearer[0, 3] = 5.0  # half a second later the vehicle is 5 m further: u = 30 instead of 40
    poses = (Message.at(0, Pose(np.eye(4))), Message.at(10**9 // 2, Pose(nearer)))
    sink = PngOverlay(folder=tmp_path, calibration=CALIBRATION)
    sink.run_once(image(10**9 // 2), None, (), Message.at(0, cloud), poses)
    painted = (drawn(tmp_path) == COLORS[5]).all(axis=-1)
    assert np.argwhere(painted).tolist() == [[40, 30]]


def test_boxes_of_this_camera_only_are_drawn(tmp_path: Path) -> None:
    def found(camera: str, box: list[float]) -> Message[Detections]:
        boxes = np.array([box], np.float32)
        payload = Detections(boxes, np.array([13]), np.array([0.9], np.float32), camera)
        return Message.at(0, payload)

    PngOverlay(folder=tmp_path).run_once(
        image(),
        None,
        (found("rgb", [10, 40, 60, 70]), None, found("thermal", [70, 40, 90, 70])),
    )
    picture = drawn(tmp_path)
    assert (picture[69:72, 20:50] == COLORS[13]).all(axis=-1).any(axis=0).all()
    assert (picture[:, 75:] == 100).all()


def test_every_nth_image_is_written_under_its_stamp(tmp_path: Path) -> None:
    sink = PngOverlay(folder=tmp_path, every=3)
    for stamp in range(7):
        sink.process(image(stamp))
    assert sorted(int(file.stem) for file in tmp_path.iterdir()) == [0, 3, 6]


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_gray_images_are_drawn_too(tmp_path: Path, kind: type) -> None:
    gray = np.zeros((80, 100), kind)
    gray[:, 50:] = 255 if kind is np.uint8 else 7_000
    PngOverlay(folder=tmp_path).run_once(image(data=gray))
    picture = drawn(tmp_path)
    assert (picture[:, :50] == 0).all()
    assert (picture[:, 50:] == 255).all()


def test_wrong_options_are_said(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="every must be at least 1"):
        PngOverlay(folder=tmp_path, every=0)
    with pytest.raises(ValueError, match=r"share must lie in 0\.\.1"):
        PngOverlay(folder=tmp_path, share=1.5)
