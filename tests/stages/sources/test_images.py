from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.errors import DataError
from stages.sources.images import ImageFolder


def read(path: Path) -> list[np.ndarray]:  # type: ignore[type-arg]
    source = ImageFolder(path=path, camera="thermal", rate_hz=4)
    source.open()
    messages = list(source.messages())
    assert [message.stamp for message in messages] == [
        250_000_000 * number for number in range(len(messages))
    ]
    assert {message.payload.camera for message in messages} == {"thermal"}
    return [message.payload.data for message in messages]


def test_color_gray_and_16_bit_pictures_come_in_the_order_of_their_names(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "c.png"), np.full((2, 3, 3), (1, 2, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "a.png"), np.full((2, 3), 9, np.uint8))
    cv2.imwrite(str(tmp_path / "b.tiff"), np.full((2, 3), 7000, np.uint16))
    cv2.imwrite(str(tmp_path / "d.png"), np.full((2, 3, 4), (1, 2, 3, 4), np.uint8))
    (tmp_path / "notes.txt").write_text("not a picture")
    gray, raw, color, with_alpha = read(tmp_path)
    assert (gray.shape, gray.dtype, gray.max()) == ((2, 3), np.uint8, 9)
    assert (raw.shape, raw.dtype, raw.max()) == ((2, 3), np.uint16, 7000)
    assert color[0, 0].tolist() == with_alpha[0, 0].tolist() == [3, 2, 1]


def test_an_empty_or_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="holds no picture"):
        ImageFolder(path=tmp_path).open()
    with pytest.raises(DataError, match="no such folder"):
        ImageFolder(path=tmp_path / "none").open()


def test_a_picture_of_unusable_depth_is_named(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((2, 3, 3), np.uint16))
    with pytest.raises(DataError, match=r"a.png: has uint16 pixels of shape \(2, 3, 3\)"):
        read(tmp_path)


def test_real_raw_thermal_keeps_its_16_bits(shared: Path) -> None:
    (raw,) = read(shared / "data" / "thermal_raw16")
    assert (raw.shape, raw.dtype) == ((512, 640), np.uint16)
    assert (raw.min(), raw.max()) == (6743, 7077)
