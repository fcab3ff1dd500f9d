"""Scores of detectors: which may be high enough, in the numbers as a file stores them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray


def may_reach(
    stored: NDArray[Any], scale: float, zero_point: int, least: float
) -> NDArray[np.bool_]:
    """Where (stored - zero_point) * scale may be at least `least`, same shape; NaN is nowhere.

    The comparison is in the stored numbers, so a whole output is looked through without being
    dequantized. Rounding may let in one count too low, never keep out one high enough.
    """
    cutoff = least / scale + zero_point
    if stored.dtype.kind in "iu":
        limits = np.iinfo(stored.dtype)
        cutoff = math.floor(min(max(cutoff, limits.min), limits.max + 1))
        if cutoff > limits.max:
            return np.zeros(stored.shape, dtype=np.bool_)
    return np.asarray(stored >= cutoff)


def logit(probability: float) -> float:
    """The x of which sigmoid(x) is the probability; of 1 the least that float32 takes for it."""
    probability = min(probability, 1 - 2.0**-25)
    return math.log(probability / (1 - probability))


def sigmoid(x: NDArray[Any]) -> NDArray[Any]:
    """1 / (1 + exp(-x)), written so that no x overflows."""
    return np.asarray(0.5 * (1 + np.tanh(0.5 * x)))


def softmax(x: NDArray[Any]) -> NDArray[Any]:
    """exp(x) / sum exp(x) over the last axis; a row with a NaN is NaN, infinities are bounded."""
    bounded = np.clip(x, -1e4, 1e4)
    powers = np.exp(bounded - bounded.max(axis=-1, keepdims=True))
    return np.asarray(powers / powers.sum(axis=-1, keepdims=True))


def best_class(scores: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Class and score (n,) of the greatest of each row (n, classes); NaN where the row has one."""
    best = scores.argmax(axis=1)
    return best, np.take_along_axis(scores, best[:, None], axis=1)[:, 0]
