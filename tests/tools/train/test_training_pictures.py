"""The pictures that a detector learns from."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from stages.types import Detections, Image
from tools.train import pictures
from tools.train.pictures import read_pictures


def test_thermal_images_of_flights_get_the_gain_of_the_graphs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    warm = np.full((48, 64), 28_000, np.uint16)
    warm[10:20, 10:20] = 30_500
    box = np.array([[10, 10, 19, 19]], np.float32)
    truth = Detections(box, np.array([5]), np.ones(1, np.float32), "thermal")
    color = Image(np.zeros((48, 64, 3), np.uint8), "rgb")

    def with_truth(*_: object) -> Iterator[tuple[Image, Detections]]:
        yield color, truth
        yield Image(warm, "thermal"), truth

    monkeypatch.setattr(pictures, "with_truth", with_truth)
    (one,) = read_pictures(tmp_path / "a.mcap", 1)
    assert one.pixels.dtype == np.uint8
    assert one.pixels[15, 15] > one.pixels[40, 40]
    assert one.boxes.tolist() == [[10, 10, 20, 20]]  # as a person would draw it
    (other,) = read_pictures(tmp_path / "a.mcap", 3)
    assert other.pixels.shape == (48, 64, 3)
