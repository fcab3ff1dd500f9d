from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from stages.codecs.lossy import Jpeg
from stages.types import Image

RAMP = np.tile(np.arange(64, dtype=np.uint8), (48, 1))


def through(image: Image) -> Image:
    return Jpeg().restore(Jpeg().shrink(image))


def test_a_color_image_is_about_the_same_and_a_tenth_of_the_size() -> None:
    data = np.stack([RAMP, 2 * RAMP, 3 * RAMP], axis=2)
    image = Image(data, "rgb")
    assert len(Jpeg().shrink(image)["jpeg"]) < data.nbytes / 5
    back = through(image)
    assert back.camera == "rgb"
    assert np.abs(back.data.astype(int) - data).mean() < 3


def test_a_gray_image_stays_gray() -> None:
    back = through(Image(RAMP, "thermal"))
    assert back.data.shape == RAMP.shape
    assert np.abs(back.data.astype(int) - RAMP).mean() < 3


def test_sixteen_bits_go_as_they_are() -> None:
    data = RAMP.astype(np.uint16) * 900
    np.testing.assert_array_equal(through(Image(data, "thermal")).data, data)


@pytest.mark.parametrize(
    "value", [None, {}, {"camera": 7}, {"camera": "rgb"}, {"camera": "rgb", "jpeg": b"no"}]
)
def test_what_is_no_picture_is_refused(value: Any) -> None:
    with pytest.raises(ValueError, match=r"no |damaged"):
        Jpeg().restore(value)
