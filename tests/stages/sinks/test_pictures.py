from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.message import Message
from stages.sinks.pictures import WritePictures
from stages.types import Image


def test_each_nth_image_is_a_file_named_by_its_stamp(tmp_path: Path) -> None:
    sink = WritePictures(folder=tmp_path, every=2)
    for stamp in range(3):
        data = np.full((4, 5, 3), (10 * stamp, 0, 200), np.uint8)
        sink.process(Message.at(stamp, Image(data, "rgb")))
    assert [file.name for file in sorted(tmp_path.iterdir())] == [f"{0:020d}.png", f"{2:020d}.png"]
    picture = cv2.imread(str(tmp_path / f"{2:020d}.png"))
    assert picture is not None
    assert picture[0, 0].tolist() == [200, 0, 20]


def test_every_must_be_a_count(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="every must be at least 1, not 0"):
        WritePictures(folder=tmp_path, every=0)
