from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stages.kernels.anchors import decode_anchored, multiscale_anchors, ssd_anchors

RATIOS = (1.0, 2.0, 0.5, 3.0, 1 / 3)


def test_ssd_has_the_anchors_of_the_public_pedestrian_network() -> None:
    maps = [(cells, cells) for cells in (19, 10, 5, 3, 2, 1)]
    anchors = ssd_anchors(maps, [0.2, 0.35, 0.5, 0.65, 0.8, 0.95], RATIOS, (300, 300))
    assert anchors.shape == (1917, 4)
    np.testing.assert_allclose(anchors[0], [0.5 / 19, 0.5 / 19, 0.1, 0.1], rtol=1e-6)
    wide = [0.5 / 19, 0.5 / 19, 0.2 / np.sqrt(2), 0.2 * np.sqrt(2)]
    np.testing.assert_allclose(anchors[1], wide, rtol=1e-6)
    np.testing.assert_allclose(anchors[-1], [0.5, 0.5, np.sqrt(0.95), np.sqrt(0.95)], rtol=1e-6)


def test_ssd_forms_are_square_in_pixels_of_a_wide_picture() -> None:
    """848 x 480, as the paper's RGB detector: a form is a part of the shorter side."""
    anchors = ssd_anchors([(30, 53)], [0.2], (1.0,), (848, 480), reduce_lowest=False)
    assert anchors.shape == (30 * 53 * 2, 4)
    height_px, width_px = anchors[0, 2] * 480, anchors[0, 3] * 848
    assert (height_px, width_px) == (pytest.approx(96), pytest.approx(96))
    np.testing.assert_allclose(anchors[2, :2] - anchors[0, :2], [0, 1 / 53], atol=1e-7)
    np.testing.assert_allclose(anchors[2 * 53, :2] - anchors[0, :2], [1 / 30, 0], atol=1e-7)


def slow_multiscale(
    levels: tuple[int, int], base: float, ratios: list[float], per_octave: int, size: list[int]
) -> list[list[float]]:
    """The definition, one anchor after another; `size` is height, width."""
    found = []
    for level in range(levels[0], levels[1] + 1):
        stride = 2.0**level
        first = [stride / 2 if length % stride == 0 else 0.0 for length in size]
        for row in range(math.ceil(size[0] / stride)):
            for column in range(math.ceil(size[1] / stride)):
                for ratio in ratios:
                    for i in range(per_octave):
                        side = base * stride * 2 ** (i / per_octave)
                        height, width = side / math.sqrt(ratio), side * math.sqrt(ratio)
                        y, x = first[0] + row * stride, first[1] + column * stride
                        found.append([y / size[0], x / size[1], height / size[0], width / size[1]])
    return found


@given(
    first=st.integers(3, 5),
    more=st.integers(0, 2),
    width=st.integers(20, 130),
    height=st.integers(20, 130),
    per_octave=st.integers(1, 3),
)
def test_multiscale_anchors_are_those_of_the_definition(
    first: int, more: int, width: int, height: int, per_octave: int
) -> None:
    levels, ratios = (first, first + more), [0.5, 1.0, 3.0]
    found = multiscale_anchors(levels, 4.0, ratios, per_octave, (width, height))
    expected = slow_multiscale(levels, 4.0, ratios, per_octave, [height, width])
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@given(seed=st.integers(0, 10_000))
def test_a_regression_moves_and_scales_its_anchor(seed: int) -> None:
    random = np.random.default_rng(seed)
    anchors = random.uniform(0.01, 0.9, (5, 4)).astype(np.float32)
    regression = random.normal(0, 2, (5, 4)).astype(np.float32)
    coder = (10.0, 9.0, 5.0, 4.0)
    found = decode_anchored(regression, anchors, coder)
    for box, (ty, tx, th, tw), (ya, xa, ha, wa) in zip(
        found, regression.tolist(), anchors.tolist(), strict=True
    ):
        y, x = ty / 10 * ha + ya, tx / 9 * wa + xa
        h, w = ha * math.exp(th / 5), wa * math.exp(tw / 4)
        np.testing.assert_allclose(
            box, [x - w / 2, y - h / 2, x + w / 2, y + h / 2], rtol=1e-5, atol=1e-6
        )


def test_a_wild_regression_neither_warns_nor_hides() -> None:
    wild = np.array([[0, 0, 3e38, 0], [np.nan, 0, 0, 0], [np.inf, 0, np.inf, 0]], np.float32)
    found = decode_anchored(wild, np.full((3, 4), 0.5, np.float32), (10.0, 10.0, 5.0, 5.0))
    assert np.isfinite(found[0]).all(), "too large, and clipped to the image later"
    assert not np.isfinite(found[1]).all()
    assert not np.isfinite(found[2]).all()
