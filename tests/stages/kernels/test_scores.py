from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stages.kernels.scores import best_class, logit, may_reach, sigmoid, softmax


@given(
    dtype=st.sampled_from(["int8", "uint8", "int16"]),
    scale=st.floats(1e-4, 10),
    zero_point=st.integers(-128, 255),
    least=st.floats(-20, 20),
)
def test_no_stored_number_is_kept_out_that_is_high_enough(
    dtype: str, scale: float, zero_point: int, least: float
) -> None:
    limits = np.iinfo(dtype)
    stored = np.unique(np.linspace(limits.min, limits.max, 256).astype(dtype))
    values = (stored.astype(np.float64) - zero_point) * scale
    found = may_reach(stored, scale, zero_point, least)
    assert found[values >= least].all()
    assert not found[values < least - scale * 1.001].any(), "more than one count too low"


def test_a_threshold_beyond_all_stored_numbers_finds_nothing_and_one_below_everything() -> None:
    stored = np.array([0, 255], np.uint8)
    assert may_reach(stored, 1.0, 0, 255.0).tolist() == [False, True]
    assert may_reach(stored, 1.0, 0, 256.0).tolist() == [False, False]
    assert may_reach(stored, 1e-30, 0, 1.0).tolist() == [False, False]
    assert may_reach(stored, 1.0, 0, -1e30).tolist() == [True, True]


def test_a_float_is_compared_as_it_is_and_nan_never_reaches() -> None:
    stored = np.array([np.nan, -np.inf, 0.4, 0.5, np.inf], np.float32)
    assert may_reach(stored, 1.0, 0, 0.5).tolist() == [False, False, False, True, True]


def test_logit_is_the_inverse_of_sigmoid_up_to_what_float32_takes_for_one() -> None:
    for probability in (0.01, 0.4, 0.5, 0.99):
        assert sigmoid(np.array(logit(probability))) == pytest.approx(probability, rel=1e-12)
    assert sigmoid(np.float32(logit(1.0)) + np.zeros(1, np.float32)) == 1.0


@pytest.mark.parametrize("odd", [np.inf, -np.inf, 3e38, -3e38])
def test_extreme_logits_are_certain_not_broken(odd: float) -> None:
    x = np.array([odd, 0.0], np.float32)
    assert sigmoid(x)[0] == float(odd > 0)
    np.testing.assert_allclose(softmax(x), [odd > 0, odd < 0], atol=1e-6)


def test_nan_stays_nan_for_the_caller_to_see() -> None:
    x = np.array([[np.nan, 0.0], [1.0, 2.0]], np.float32)
    assert np.isnan(sigmoid(x)[0, 0])
    assert np.isnan(softmax(x)[0]).all()
    assert np.isnan(best_class(x)[1][0])


@given(seed=st.integers(0, 10_000))
def test_softmax_is_the_equation(seed: int) -> None:
    x: Any = np.random.default_rng(seed).normal(0, 5, (4, 6))
    expected = np.exp(x) / np.exp(x).sum(axis=-1, keepdims=True)
    np.testing.assert_allclose(softmax(x.astype(np.float32)), expected, atol=1e-6)
