from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stages.kernels.grid_boxes import decode_fastestdet, decode_yolo, yolo_grid


def test_a_cell_of_fastestdet_becomes_its_box() -> None:
    cell = np.array([[0.8, np.arctanh(0.5), 0.0, 0.0, -np.log(3.0), 0.1, 0.6]], np.float32)
    boxes, classes, scores = decode_fastestdet(cell, np.array([2]), np.array([3]), (4, 8))
    center_x, center_y, width, height = (3 + 0.5) / 8, 2 / 4, 0.5, 0.25
    expected = [center_x - width / 2, center_y - height / 2, center_x + width / 2]
    np.testing.assert_allclose(boxes, [[*expected, center_y + height / 2]], rtol=1e-6)
    assert classes.tolist() == [1]
    np.testing.assert_allclose(scores, [0.8**0.6 * 0.6**0.4], rtol=1e-6)


def test_fastestdet_of_an_8_bit_file_may_be_a_hair_outside_of_its_range() -> None:
    cells = np.array([[-0.01] * 7, [1.02] * 7], np.float32)
    _, _, scores = decode_fastestdet(cells, np.arange(2), np.arange(2), (2, 2))
    assert scores.tolist() == [0, 1]


def test_the_grid_of_yolo_goes_through_its_maps_row_by_row() -> None:
    grid = yolo_grid((8, 16), (32, 16))
    assert len(grid) == 4 * 2 + 2 * 1
    assert grid[:5].tolist() == [[0, 0, 8], [1, 0, 8], [2, 0, 8], [3, 0, 8], [0, 1, 8]]
    assert grid[-1].tolist() == [1, 0, 16]


@given(seed=st.integers(0, 10_000))
def test_raw_numbers_of_yolo_are_relative_to_their_cell(seed: int) -> None:
    random = np.random.default_rng(seed)
    raw = random.normal(0, 1, (3, 4)).astype(np.float32)
    grid = np.array([[0, 0, 8], [5, 2, 16], [1, 9, 32]], np.float64)
    found = decode_yolo(raw, grid)
    for box, (x, y, w, h), (column, row, stride) in zip(
        found, raw.tolist(), grid.tolist(), strict=True
    ):
        cx, cy = (x + column) * stride, (y + row) * stride
        w, h = math.exp(w) * stride, math.exp(h) * stride
        expected = [cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2]
        np.testing.assert_allclose(box, expected, rtol=1e-5, atol=1e-4)


def test_finished_boxes_of_yolo_become_corners() -> None:
    found = decode_yolo(np.array([[10, 20, 4, 6]], np.float32), None)
    assert found.tolist() == [[8, 17, 12, 23]]


@pytest.mark.parametrize("odd", [np.nan, np.inf, -np.inf, 3e38])
def test_odd_numbers_neither_warn_nor_come_out_as_sound_boxes(odd: float) -> None:
    boxes = decode_yolo(np.full((1, 4), odd, np.float32), None)
    assert odd == 3e38 or not np.isfinite(boxes).all()
