from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stages.kernels.boxes import (
    decode_detection_output,
    decode_fastestdet,
    decode_ssd,
    ssd_anchors,
    suppress,
    to_image,
)
from stages.kernels.network_input import placement


def test_detection_output_is_read_up_to_its_end_mark() -> None:
    rows = np.array(
        [
            [0, 1, 0.9, 0.1, 0.2, 0.3, 0.4],
            [0, 2, 0.1, 0.1, 0.2, 0.3, 0.4],
            [0, 2, 0.5, 0.5, 0.6, 0.7, 0.8],
            [-1, 0, 0, 0, 0, 0, 0],
            [0, 1, 1.0, 0.0, 0.0, 1.0, 1.0],
        ],
        dtype=np.float32,
    )
    boxes, classes, scores = decode_detection_output(rows, 0.5)
    np.testing.assert_allclose(boxes, rows[[0, 2], 3:], rtol=1e-6)
    assert classes.tolist() == [1, 2]
    np.testing.assert_allclose(scores, [0.9, 0.5], rtol=1e-6)


def test_a_cell_of_fastestdet_becomes_its_box() -> None:
    grid = np.zeros((4, 8, 7), dtype=np.float32)
    grid[2, 3] = [0.8, np.arctanh(0.5), 0.0, 0.0, -np.log(3.0), 0.1, 0.6]
    boxes, classes, scores = decode_fastestdet(grid, 0.3)
    center_x, center_y, width, height = (3 + 0.5) / 8, 2 / 4, 0.5, 0.25
    expected = [center_x - width / 2, center_y - height / 2, center_x + width / 2]
    np.testing.assert_allclose(boxes, [[*expected, center_y + height / 2]], rtol=1e-6)
    assert classes.tolist() == [1]
    np.testing.assert_allclose(scores, [0.8**0.6 * 0.6**0.4], rtol=1e-6)


def test_ssd_has_the_anchors_of_the_public_pedestrian_network() -> None:
    anchors = ssd_anchors([19, 10, 5, 3, 2, 1], [0.2, 0.35, 0.5, 0.65, 0.8, 0.95])
    assert anchors.shape == (1917, 4)
    np.testing.assert_allclose(anchors[0], [0.5 / 19, 0.5 / 19, 0.1, 0.1], rtol=1e-6)
    wide = [0.5 / 19, 0.5 / 19, 0.2 / np.sqrt(2), 0.2 * np.sqrt(2)]
    np.testing.assert_allclose(anchors[1], wide, rtol=1e-6)
    np.testing.assert_allclose(anchors[-1], [0.5, 0.5, np.sqrt(0.95), np.sqrt(0.95)], rtol=1e-6)


def test_ssd_regression_moves_and_scales_its_anchor() -> None:
    anchors = np.array([[0.5, 0.4, 0.2, 0.1], [0.1, 0.1, 0.1, 0.1]], dtype=np.float32)
    regression = np.array([[1, -2, 5 * np.log(2), 0], [0, 0, 0, 0]], dtype=np.float32)
    logits = np.array([[9, 0, 2], [9, -5, -5]], dtype=np.float32)
    boxes, classes, scores = decode_ssd(regression, logits, anchors, 0.5)
    y, x, height, width = 0.5 + 0.1 * 0.2, 0.4 - 0.2 * 0.1, 0.4, 0.1
    expected = [[x - width / 2, y - height / 2, x + width / 2, y + height / 2]]
    np.testing.assert_allclose(boxes, expected, rtol=1e-5)
    assert classes.tolist() == [2]
    np.testing.assert_allclose(scores, [1 / (1 + np.exp(-2))], rtol=1e-6)


@given(
    image=st.tuples(st.integers(50, 2000), st.integers(50, 2000)),
    picture=st.tuples(st.integers(64, 600), st.integers(64, 600)),
    letterbox=st.booleans(),
)
def test_a_box_of_the_whole_image_comes_back_as_the_whole_image(
    image: tuple[int, int], picture: tuple[int, int], letterbox: bool
) -> None:
    where = placement(image, picture, letterbox=letterbox)
    corners = np.array([[0, 0], image]) * where[:2] + where[2:]
    box = (corners / picture).reshape(1, 4).astype(np.float32)
    found = to_image(box, picture, where, image)
    np.testing.assert_allclose(found, [[0, 0, *image]], atol=0.01 + 2e-5 * max(image) * 10)


def test_boxes_are_clipped_to_the_image() -> None:
    where = placement((100, 50), (10, 10))
    found = to_image(np.array([[-0.5, 0.2, 1.5, 2.0]], np.float32), (10, 10), where, (100, 50))
    assert found.tolist() == [[0, 10, 100, 50]]


def slow_suppress(boxes: np.ndarray, classes: np.ndarray, scores: np.ndarray, most: float) -> list:  # type: ignore[type-arg]
    """The definition: best first, each kept box removes its class's boxes that overlap it."""
    left = sorted(range(len(boxes)), key=lambda i: -scores[i])
    kept = []
    while left:
        best = left.pop(0)
        kept.append(best)

        def iou(other: int, best: int = best) -> float:
            low = np.maximum(boxes[best, :2], boxes[other, :2])
            high = np.minimum(boxes[best, 2:], boxes[other, 2:])
            shared = np.prod(np.maximum(high - low, 0))
            areas = [np.prod(boxes[i, 2:] - boxes[i, :2]) for i in (best, other)]
            return float(shared / (sum(areas) - shared))

        left = [i for i in left if classes[i] != classes[best] or iou(i) <= most]
    return kept


@given(seed=st.integers(0, 10_000), n=st.integers(0, 25), most=st.sampled_from([0.3, 0.5, 0.7]))
def test_suppression_is_greedy_per_class(seed: int, n: int, most: float) -> None:
    random = np.random.default_rng(seed)
    low = random.uniform(0, 50, (n, 2))
    boxes = np.hstack([low, low + random.uniform(5, 40, (n, 2))]).astype(np.float32)
    classes = random.integers(0, 2, n)
    scores = random.permutation(n).astype(np.float32) / 100
    found = suppress(boxes, classes, scores, most)
    assert found.tolist() == slow_suppress(boxes, classes, scores, most)


def test_equal_scores_keep_their_order() -> None:
    boxes = np.array([[0, 0, 2, 2], [5, 5, 7, 7], [9, 9, 12, 12]], dtype=np.float32)
    found = suppress(boxes, np.zeros(3, np.int64), np.full(3, 0.5, np.float32), 0.5)
    assert found.tolist() == [0, 1, 2]


def test_fastestdet_of_an_8_bit_file_may_be_a_hair_below_zero() -> None:
    grid = np.full((2, 2, 7), -0.01, dtype=np.float32)
    boxes, _, scores = decode_fastestdet(grid, 0.1)
    assert boxes.shape == (0, 4)
    assert scores == pytest.approx([])
