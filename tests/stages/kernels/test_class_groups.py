from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from stages.kernels.class_groups import (
    FLOOR,
    grouped_log_scores,
    label_log_scores,
    membership,
)

GROUPS = {0: 3, 1: 3, 2: 1, 4: 0}  # the network's class 3 has no counterpart
CLASSES, CHANNELS = 5, 8


@given(seed=st.integers(0, 1000), temperature=st.floats(0.3, 5))
def test_probabilities_of_merged_classes_add_up(seed: int, temperature: float) -> None:
    logits = np.random.default_rng(seed).normal(scale=5, size=(2, 3, 5)).astype(np.float32)
    member = membership(GROUPS, 5, CHANNELS)
    found = grouped_log_scores(logits, member, CLASSES, temperature=temperature, padding=-1e4)
    p = np.exp(logits.astype(np.float64) / temperature)
    p /= p.sum(axis=-1, keepdims=True)
    expected = np.stack(
        [p[..., 4], p[..., 2], 0 * p[..., 0], p[..., 0] + p[..., 1], 0 * p[..., 0]], axis=-1
    )
    np.testing.assert_allclose(
        found[..., :CLASSES], np.log(np.maximum(expected, FLOOR)), rtol=1e-4, atol=1e-4
    )
    assert (found[..., CLASSES:] == -1e4).all()
    assert found.dtype == np.float32


def test_the_logits_are_left_as_they_were() -> None:
    logits = np.ones((1, 5), dtype=np.float32)
    member = membership(GROUPS, 5, CHANNELS)
    grouped_log_scores(logits, member, CLASSES, temperature=1.0, padding=-1e4)
    assert (logits == 1).all()


def test_a_label_has_its_confidence_and_the_others_share_the_rest_evenly() -> None:
    member = membership(GROUPS, 5, CHANNELS)
    rows = label_log_scores(member, 0.9, CLASSES, padding=-1e4)
    other = 0.1 / 4
    np.testing.assert_allclose(
        np.exp(rows[0, :CLASSES]), [other, other, FLOOR, 0.9 + other, FLOOR], rtol=1e-4
    )
    np.testing.assert_allclose(
        np.exp(rows[3, :CLASSES]), [other, other, FLOOR, 2 * other, FLOOR], rtol=1e-4
    )
    assert (rows[:, CLASSES:] == -1e4).all()
