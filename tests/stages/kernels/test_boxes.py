from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from stages.kernels.boxes import class_ids, from_center, is_finite, suppress, to_image
from stages.kernels.network_input import placement


def test_centers_and_sizes_become_corners() -> None:
    found = from_center(*(np.array([value]) for value in (10.0, 20.0, 4.0, 6.0)))
    assert found.tolist() == [[8, 17, 12, 23]]
    assert found.dtype == np.float32


def test_what_is_no_number_after_the_corners_is_seen_as_such() -> None:
    huge = np.array([np.inf, np.nan, 1e300])
    boxes = from_center(huge, np.zeros(3), huge, np.ones(3))
    assert not is_finite(boxes, np.ones(3, np.float32)).any()
    assert not is_finite(np.zeros((1, 4), np.float32), np.array([np.nan], np.float32)).any()


def test_classes_come_as_any_numbers_and_odd_ones_are_none() -> None:
    given = np.array([0, 2.0, 1.0001, -1, np.nan, np.inf, -np.inf, 1e30], np.float32)
    assert class_ids(given).tolist() == [0, 2, 1, -1, -1, -1, -1, -1]


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


@given(
    seed=st.integers(0, 10_000),
    n=st.integers(0, 25),
    most=st.sampled_from([0.3, 0.5, 0.7]),
    limit=st.sampled_from([1, 5, 100]),
)
def test_suppression_is_greedy_per_class(seed: int, n: int, most: float, limit: int) -> None:
    random = np.random.default_rng(seed)
    low = random.uniform(0, 50, (n, 2))
    boxes = np.hstack([low, low + random.uniform(5, 40, (n, 2))]).astype(np.float32)
    classes = random.integers(0, 2, n)
    scores = random.permutation(n).astype(np.float32) / np.float32(100)
    found = suppress(boxes, classes, scores, most, limit)
    assert found.tolist() == slow_suppress(boxes, classes, scores, most)[:limit]


def test_equal_scores_keep_their_order() -> None:
    boxes = np.array([[0, 0, 2, 2], [5, 5, 7, 7], [9, 9, 12, 12]], dtype=np.float32)
    found = suppress(boxes, np.zeros(3, np.int64), np.full(3, 0.5, np.float32), 0.5, 100)
    assert found.tolist() == [0, 1, 2]
