from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from stages.kernels.agreement import box_overlap, label_agreement, match_boxes
from stages.kernels.metrics import confusion

LABELS = hnp.arrays(np.uint8, 60, elements=st.integers(0, 4))


@given(a=LABELS, b=LABELS)
def test_the_agreement_of_labels_is_that_of_plain_counting(
    a: NDArray[np.uint8], b: NDArray[np.uint8]
) -> None:
    found = label_agreement(confusion(a, b))
    assert found.places == 60
    assert found.same == pytest.approx((a == b).mean())
    ious = []
    for label in range(16):
        either = (a == label) | (b == label)
        if either.any():
            ious.append((((a == label) & (b == label)).sum()) / either.sum())
            assert found.iou[label] == pytest.approx(ious[-1])
        else:
            assert np.isnan(found.iou[label])
        shares = (a == label).mean(), (b == label).mean()
        np.testing.assert_allclose(found.share[:, label], shares)
    assert found.mean_iou == pytest.approx(np.mean(ious))


@given(a=LABELS, b=LABELS)
def test_exchanging_the_sides_changes_no_agreement(
    a: NDArray[np.uint8], b: NDArray[np.uint8]
) -> None:
    one, other = label_agreement(confusion(a, b)), label_agreement(confusion(b, a))
    assert (one.same, one.mean_iou) == (other.same, other.mean_iou)
    np.testing.assert_array_equal(one.iou, other.iou)
    np.testing.assert_array_equal(one.share, other.share[::-1])


def test_a_class_that_is_rare_on_both_sides_is_not_in_the_mean() -> None:
    matrix = np.zeros((16, 16), dtype=np.int64)
    matrix[3, 3], matrix[5, 6] = 99_999, 1
    found = label_agreement(matrix)
    assert found.iou[5] == 0
    assert found.mean_iou == pytest.approx(1.0, abs=1e-4)


def test_nothing_to_compare_is_no_agreement_and_no_zero() -> None:
    found = label_agreement(np.zeros((16, 16), dtype=np.int64))
    assert found.places == 0
    assert np.isnan(found.same)
    assert np.isnan(found.mean_iou)


def pixels_of(box: NDArray[np.float32]) -> NDArray[np.bool_]:
    picture = np.zeros((12, 12), dtype=np.bool_)
    x0, y0, x1, y1 = box.astype(int)
    picture[y0 : max(y0, y1), x0 : max(x0, x1)] = True
    return picture


BOXES = hnp.arrays(
    np.float32, st.tuples(st.integers(0, 6), st.just(4)), elements=st.integers(0, 12)
)


@given(a=BOXES, b=BOXES)
def test_the_overlap_of_boxes_is_that_of_their_pixels(
    a: NDArray[np.float32], b: NDArray[np.float32]
) -> None:
    found = box_overlap(a, b)
    for i, one in enumerate(a):
        for j, other in enumerate(b):
            both = pixels_of(one) & pixels_of(other)
            either = pixels_of(one) | pixels_of(other)
            expected = both.sum() / either.sum() if both.any() else 0.0
            assert found[i, j] == pytest.approx(expected)


@given(a=BOXES, b=BOXES, data=st.data())
def test_boxes_match_once_within_their_class_and_none_is_left_that_could(
    a: NDArray[np.float32], b: NDArray[np.float32], data: st.DataObject
) -> None:
    classes_a, classes_b = (
        np.array(data.draw(st.lists(st.integers(1, 2), min_size=len(c), max_size=len(c))), np.int64)
        for c in (a, b)
    )
    pairs, overlaps = match_boxes(a, classes_a, b, classes_b, 0.3)
    overlap = box_overlap(a, b)
    assert len(set(pairs[:, 0])) == len(set(pairs[:, 1])) == len(pairs)
    np.testing.assert_array_equal(overlaps, overlap[pairs[:, 0], pairs[:, 1]])
    assert (np.diff(overlaps) <= 0).all()
    assert (overlaps >= 0.3).all()
    np.testing.assert_array_equal(classes_a[pairs[:, 0]], classes_b[pairs[:, 1]])
    left_a = sorted(set(range(len(a))) - set(pairs[:, 0]))
    left_b = sorted(set(range(len(b))) - set(pairs[:, 1]))
    alone = overlap[np.ix_(left_a, left_b)]
    alone[classes_a[left_a][:, None] != classes_b[left_b][None, :]] = 0
    assert not (alone >= 0.3).any()


def test_the_pair_that_overlaps_most_is_taken_first() -> None:
    a = np.array([[0, 0, 10, 10], [0, 0, 10, 8]], np.float32)
    b = np.array([[0, 0, 10, 8]], np.float32)
    pairs, overlaps = match_boxes(a, np.ones(2, np.int64), b, np.ones(1, np.int64), 0.5)
    assert pairs.tolist() == [[1, 0]]
    assert overlaps.tolist() == [1.0]
