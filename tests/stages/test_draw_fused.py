from __future__ import annotations

import numpy as np
import pytest

from pipeline.message import Message
from stages.draw_fused import DrawFused
from stages.fused import FusedImage, FusionStatus
from stages.taxonomy import load_taxonomy
from stages.types import Image

COLORS = load_taxonomy().colors
PERSON = 5


def test_the_classes_are_laid_over_the_image_of_the_same_camera() -> None:
    mask = np.zeros((6, 8), np.uint8)
    mask[:, 4:] = PERSON
    fused = FusedImage(mask, np.ones(mask.shape, np.float32), None, "rgb", FusionStatus(0), 0.0)
    image = Image(np.full((6, 8, 3), 100, np.uint8), "rgb")
    drawn = DrawFused().process(Message.at(0, fused), Message.at(0, image))
    assert drawn.camera == "rgb"
    assert (drawn.data[:, :4] == 100).all()
    np.testing.assert_allclose(drawn.data[0, 4], (COLORS[PERSON] + 100.0) / 2, atol=1)
    assert (DrawFused().process(Message.at(0, fused)).data[:, 4:] == COLORS[PERSON]).all()


def test_a_share_is_a_part_of_one() -> None:
    with pytest.raises(ValueError, match=r"share must lie in 0\.\.1, not 2"):
        DrawFused(share=2)
