"""The map from above, as a file."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from pipeline.message import Message
from stages.sinks.top_view import TopView
from stages.types import SemanticVoxels


def test_the_last_map_is_drawn_on_close_with_pale_ground_and_full_cars(tmp_path: Path) -> None:
    indices = np.stack(np.meshgrid(np.arange(40), np.arange(20), [0], indexing="ij"), axis=-1)
    indices = indices.reshape(-1, 3).astype(np.int32)
    positions = ((indices + 0.5) * 0.25).astype(np.float32)
    log_scores = np.zeros((len(indices), 16), np.float32)
    car = (indices[:, 0] >= 10) & (indices[:, 0] < 20) & (indices[:, 1] < 5)
    log_scores[:, 3], log_scores[car, 13] = 2.0, 4.0
    log_scores[indices[:, 1] == 19, 8] = 9.0  # sky: not drawn
    counts = np.ones(len(indices), np.int32)
    voxels = SemanticVoxels(0.25, indices, positions, log_scores, counts)
    path = tmp_path / "map_top.png"
    TopView(path=path).run_once(Message.at(0, voxels))
    image = cv2.imread(str(path))
    assert image is not None
    rgb = image[..., ::-1][: 16 + 19 * 8]  # above the legend: 19 rows of 8 pixels and the margin
    assert (rgb == (129, 0, 127)).all(axis=-1).sum() == 50 * 64
    assert (rgb == (191, 159, 191)).all(axis=-1).sum() == (40 * 19 - 50) * 64


def test_an_empty_map_is_a_picture_too(tmp_path: Path) -> None:
    nothing = np.zeros((0, 3))
    voxels = SemanticVoxels(
        0.25,
        nothing.astype(np.int32),
        nothing.astype(np.float32),
        np.zeros((0, 16), np.float32),
        np.zeros(0, np.int32),
    )
    TopView(path=tmp_path / "a.png").run_once(Message.at(0, voxels))
    assert cv2.imread(str(tmp_path / "a.png")) is not None
