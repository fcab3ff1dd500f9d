"""Fusion in log scores against eq 2-4 written out in probabilities."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stages.kernels.probability import (
    LEAST,
    PADDING,
    accumulate,
    add_detection,
    bound_rows,
    read_out,
    softmax,
    uniform_rows,
)

C = 15
rows = arrays(np.float32, (4, 16), elements=st.floats(-12, 0, width=32))


def fuse(*sources: np.ndarray) -> np.ndarray:
    """Posteriors of the product of sources (n, 16), through the kernels."""
    n = len(sources[0])
    total, evidence = uniform_rows(n, C), np.zeros(n, bool)
    for source in sources:
        accumulate(total, evidence, np.arange(n), source, np.ones(n, bool), C)
    assert evidence.all()
    return softmax(total, C)


def exact_softmax(log_scores: np.ndarray) -> np.ndarray:
    p = np.exp(log_scores[:, :C].astype(np.float64))
    return p / p.sum(axis=1, keepdims=True)


@settings(deadline=None)  # the first example compiles
@given(rows, rows)
def test_fusion_is_the_normalized_product_of_eq_2_and_3(a: np.ndarray, b: np.ndarray) -> None:
    product = exact_softmax(a) * exact_softmax(b)
    expected = product / product.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(fuse(a, b), expected, atol=3e-6)


@settings(deadline=None)  # the first example compiles
@given(rows, rows, rows)
def test_fusion_sums_to_one_and_does_not_depend_on_the_order(
    a: np.ndarray, b: np.ndarray, c: np.ndarray
) -> None:
    np.testing.assert_allclose(fuse(a, b, c).sum(axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(fuse(a, b, c), fuse(c, a, b), atol=3e-6)


@settings(deadline=None)  # the first example compiles
@given(rows, st.floats(-5, 5))
def test_a_uniform_source_changes_nothing(a: np.ndarray, level: float) -> None:
    uniform = np.full_like(a, level)
    np.testing.assert_allclose(fuse(a, uniform), fuse(a), atol=3e-6)


def test_points_that_a_source_does_not_see_keep_what_they_had() -> None:
    total, evidence = uniform_rows(3, C), np.zeros(3, bool)
    row = np.zeros((2, 16), np.float32)
    row[:, 4] = 2.0
    accumulate(total, evidence, np.array([2, 0]), row, np.array([True, False]), C)
    assert evidence.tolist() == [False, False, True]
    assert total[:, 4].tolist() == [0, 0, 2]
    assert (total[:, C:] == PADDING).all()


@settings(deadline=None)  # the first example compiles
@given(rows, st.floats(1, 5))
def test_bounding_keeps_probabilities_down_to_a_millionth_of_the_greatest(
    a: np.ndarray, sharper: float
) -> None:
    a *= np.float32(sharper)
    bounded = a.copy()
    assert bound_rows(bounded, C).all()
    p = softmax(bounded, C).astype(np.float64)
    expected = a[:, :C].astype(np.float64) - a[:, :C].max(axis=1, keepdims=True)
    expected = np.maximum(np.exp(expected), LEAST)
    np.testing.assert_allclose(p, expected / expected.sum(axis=1, keepdims=True), atol=1e-6)
    assert (p / p.max(axis=1, keepdims=True)).min() >= LEAST * 0.999


@pytest.mark.parametrize("spoiler", [np.nan, np.inf])
def test_a_spoiled_row_becomes_uniform_and_is_marked(spoiler: float) -> None:
    a = np.tile(np.arange(16, dtype=np.float32), (3, 1))
    a[1, 6] = spoiler
    assert bound_rows(a, C).tolist() == [True, False, True]
    assert (a[1, :C] == 0).all()
    assert a[0, C - 1] == 0


def test_a_hard_zero_does_not_veto_a_class() -> None:
    a = np.zeros((1, 16), np.float32)
    a[0, 1:C] = -np.inf
    assert bound_rows(a, C).all()
    assert a[0, 1:C] == pytest.approx(np.log(LEAST))


@settings(deadline=None)  # the first example compiles
@given(rows, st.floats(0.0, 1.0), st.floats(0, 100), st.floats(0, 50), st.integers(0, C - 1))
def test_a_detection_is_eq_4_and_bayes(
    prior: np.ndarray, score: float, u: float, v: float, label: int
) -> None:
    box = np.array([0, 0, 100, 50], np.float32)
    total, evidence = prior.copy(), np.zeros(4, bool)
    pixel = np.array([[u, v]], np.float32)
    add_detection(total, evidence, np.array([2]), pixel, np.array([0]), box, score, label, C)

    gauss = np.exp(-0.5 * (((u - 50) / 50) ** 2 + ((v - 25) / 25) ** 2))
    s = np.clip(score * gauss, 1 / C, 0.999)
    p_det = np.full(C, (1 - s) / (C - 1))
    p_det[label] = s
    product = exact_softmax(prior)[2] * p_det
    np.testing.assert_allclose(softmax(total, C)[2], product / product.sum(), atol=5e-6)
    assert evidence.tolist() == [False, False, True, False]
    np.testing.assert_array_equal(total[[0, 1, 3]], prior[[0, 1, 3]])


def test_a_weak_detection_is_neutral() -> None:
    total, evidence = uniform_rows(1, C), np.zeros(1, bool)
    box, pixel = np.array([0, 0, 10, 10], np.float32), np.array([[5, 5]], np.float32)
    add_detection(total, evidence, np.array([0]), pixel, np.array([0]), box, 0.01, 5, C)
    assert softmax(total, C)[0] == pytest.approx(1 / C)


def test_a_box_without_extent_is_no_division_by_zero() -> None:
    total, evidence = uniform_rows(1, C), np.zeros(1, bool)
    box, pixel = np.array([5, 5, 5, 5], np.float32), np.array([[5, 5]], np.float32)
    add_detection(total, evidence, np.array([0]), pixel, np.array([0]), box, 0.8, 5, C)
    assert softmax(total, C)[0, 5] == pytest.approx(0.8)


@settings(deadline=None)  # the first example compiles
@given(rows)
def test_the_read_out_is_argmax_probability_and_entropy(a: np.ndarray) -> None:
    label, confidence, entropy = read_out(a, C)
    p = exact_softmax(a)
    assert label.tolist() == a[:, :C].argmax(axis=1).tolist()
    np.testing.assert_allclose(confidence, p.max(axis=1), rtol=1e-5)
    np.testing.assert_allclose(entropy, -(p * np.log(p)).sum(axis=1), atol=1e-5)


def test_ties_go_to_the_lowest_class_and_nothing_known_is_background() -> None:
    label, confidence, entropy = read_out(uniform_rows(1, C), C)
    assert label[0] == 0
    assert confidence[0] == pytest.approx(1 / C)
    assert entropy[0] == pytest.approx(np.log(C))
