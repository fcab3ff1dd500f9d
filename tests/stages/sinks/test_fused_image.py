"""Overlays of fused images, looked at by the pixel."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.message import Message
from stages.fused import FusedImage, FusionStatus
from stages.sinks.fused_image import FusedOverlay
from stages.taxonomy import load_taxonomy
from stages.types import Image

COLORS = load_taxonomy().colors
PERSON = 5


def fused(stamp: int = 0) -> Message[FusedImage]:
    mask = np.zeros((6, 8), np.uint8)
    mask[:, 4:] = PERSON
    ones = np.ones(mask.shape, np.float32)
    return Message.at(stamp, FusedImage(mask, ones, None, "rgb", FusionStatus(0), 0.0))


def drawn(folder: Path) -> np.ndarray:
    (file,) = folder.glob("*.png")
    picture = cv2.imread(str(file))
    assert picture is not None
    return picture[..., ::-1]


def test_without_an_image_the_picture_is_the_mask_in_class_colors(tmp_path: Path) -> None:
    FusedOverlay(folder=tmp_path).run_once(fused())
    picture = drawn(tmp_path)
    assert (picture[:, :4] == COLORS[0]).all()
    assert (picture[:, 4:] == COLORS[PERSON]).all()


@pytest.mark.parametrize("shape", [(6, 8, 3), (6, 8)])
def test_classes_are_laid_over_the_image_and_background_is_not(
    tmp_path: Path, shape: tuple[int, ...]
) -> None:
    image = Message.at(0, Image(np.full(shape, 100, np.uint8), "rgb"))
    FusedOverlay(folder=tmp_path, share=0.5).run_once(fused(), image)
    picture = drawn(tmp_path)
    assert (picture[:, :4] == 100).all()
    np.testing.assert_allclose(picture[0, 4], (COLORS[PERSON] + 100.0) / 2, atol=1)


def test_every_nth_image_is_written_under_its_stamp(tmp_path: Path) -> None:
    sink = FusedOverlay(folder=tmp_path, every=3)
    for stamp in range(7):
        sink.process(fused(stamp))
    assert sorted(int(file.stem) for file in tmp_path.iterdir()) == [0, 3, 6]


def test_wrong_options_are_said(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="every must be at least 1"):
        FusedOverlay(folder=tmp_path, every=0)
    with pytest.raises(ValueError, match=r"share must lie in 0\.\.1"):
        FusedOverlay(folder=tmp_path, share=1.5)
