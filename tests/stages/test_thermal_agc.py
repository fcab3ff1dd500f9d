"""The thermal gain control stage, on made frames and on a real one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pipeline.errors import StageError
from pipeline.message import Message
from stages.thermal_agc import ThermalAgc
from stages.types import Image

MODES = ("linear", "plateau", "clahe")


def image(data: np.ndarray) -> Message[Image]:
    return Message.at(0, Image(data, "thermal"))


def raw(low: int = 7000, high: int = 7400) -> np.ndarray:
    return np.random.default_rng(0).integers(low, high, (64, 80)).astype(np.uint16)


@pytest.mark.parametrize("mode", MODES)
def test_a_constant_frame_is_middle_gray(mode: Any) -> None:
    agc = ThermalAgc(mode=mode)
    for _ in range(3):
        gray = agc.process(image(np.full((64, 80), 7000, np.uint16)))
        assert (gray.data == 128).all()


@pytest.mark.parametrize("mode", MODES)
def test_dead_pixels_do_not_change_the_rest(mode: Any) -> None:
    spoiled = raw()
    spoiled[5, :4], spoiled[9, 3:8] = 0, 65535
    clean, shown = (
        ThermalAgc(mode=mode).run_once(image(data)).data.astype(int) for data in (raw(), spoiled)
    )
    alive = (spoiled > 0) & (spoiled < 65535)
    assert np.abs(clean - shown)[alive].max() <= (8 if mode == "clahe" else 1)


@pytest.mark.parametrize("mode", MODES)
def test_a_frame_of_dead_pixels_leaves_the_gain_as_it_was(mode: Any) -> None:
    agc = ThermalAgc(mode=mode, follow=1.0)
    before = agc.process(image(raw())).data
    agc.process(image(np.zeros((64, 80), np.uint16)))
    np.testing.assert_array_equal(agc.process(image(raw())).data, before)
    assert (ThermalAgc(mode=mode).run_once(image(np.zeros((4, 4), np.uint16))).data == 128).all()


@pytest.mark.parametrize("mode", MODES)
def test_frames_of_no_or_one_pixel_pass(mode: Any) -> None:
    for shape in ((0, 0), (0, 7), (1, 1), (1, 9)):
        data = raw()[: shape[0], : shape[1]]
        assert ThermalAgc(mode=mode).run_once(image(data)).data.shape == shape


@pytest.mark.parametrize("mode", ["linear", "plateau"])
def test_a_warm_object_that_enters_does_not_make_the_scene_flicker(mode: Any) -> None:
    warm = raw()
    warm[:20, :20] = 9000
    agc, sudden = ThermalAgc(mode=mode), ThermalAgc(mode=mode, follow=1.0)
    change = []
    for stage in (agc, sudden):
        first = stage.process(image(raw())).data.astype(int)
        second = stage.process(image(warm)).data.astype(int)
        change.append(np.abs(second - first)[20:, 20:].mean())
    assert change[0] < 0.4 * change[1]


def test_the_gain_arrives_at_a_new_scene() -> None:
    agc = ThermalAgc()
    agc.process(image(raw(3000, 3100)))
    for _ in range(60):
        gray = agc.process(image(raw())).data
    np.testing.assert_allclose(gray, ThermalAgc().run_once(image(raw())).data, atol=6)


def test_an_8_bit_image_passes_uncopied() -> None:
    message = image(np.zeros((4, 4), np.uint8))
    assert ThermalAgc().run_once(message) is message.payload


def test_a_color_image_in_16_bit_is_refused() -> None:
    with pytest.raises(StageError, match="camera 'thermal' gives uint16 images of shape"):
        ThermalAgc().process(image(np.zeros((4, 4, 3), np.uint16)))


@pytest.mark.parametrize(
    "options", [{"mode": "auto"}, {"follow": 0.0}, {"plateau": 2.0}, {"max_gain": 0}, {"tiles": 0}]
)
def test_wrong_options_are_said(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        ThermalAgc(**options)


@pytest.mark.parametrize("mode", MODES)
def test_a_real_frame_uses_the_range_of_8_bits(mode: Any, shared: Path) -> None:
    file = shared / "data" / "thermal_raw16" / "example_radiometric.tiff"
    counts = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    assert counts is not None
    gray = ThermalAgc(mode=mode).run_once(image(counts)).data
    assert (gray.shape, gray.dtype) == ((512, 640), np.uint8)
    assert gray.std() > 35
    assert 60 < np.median(gray) < 200
    assert (gray == 0).mean() + (gray == 255).mean() < 0.05
