"""From a network's classes to ours: probabilities of merged classes add up."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

#: Probability of a class that the network does not know or gives less.
FLOOR = 1e-6


def membership(
    groups: Mapping[int, int], network_classes: int, channels: int
) -> NDArray[np.float32]:
    """(network_classes, channels) 1 where a network's class belongs to one of ours, else 0."""
    matrix = np.zeros((network_classes, channels), dtype=np.float32)
    for theirs, ours in groups.items():
        matrix[theirs, ours] = 1.0
    return matrix


def grouped_log_scores(
    logits: NDArray[np.float32],
    member: NDArray[np.float32],
    classes: int,
    *,
    temperature: float,
    padding: float,
) -> NDArray[np.float32]:
    """Log-probabilities of our classes from a network's logits (..., network classes).

    p = soft-max(logits / temperature); ours = log(max(sum of the members' p, FLOOR)), a log-sum-exp
    over each group of `member` (network classes, channels). Channels from `classes` on hold
    `padding`. Returns (..., channels) float32.
    """
    scaled = logits / np.float32(temperature)
    scaled -= scaled.max(axis=-1, keepdims=True)
    p = np.exp(scaled, out=scaled)
    p /= p.sum(axis=-1, keepdims=True)
    scores: NDArray[np.float32] = np.log(np.maximum(p @ member, np.float32(FLOOR)))
    scores[..., classes:] = padding
    return scores


def label_log_scores(
    member: NDArray[np.float32], confidence: float, classes: int, *, padding: float
) -> NDArray[np.float32]:
    """(network classes, channels) row k: our log-probabilities where the network says label k.

    The label has probability `confidence`, the network's other labels share the rest evenly.
    """
    count = len(member)
    p = np.full((count, count), (1.0 - confidence) / (count - 1), dtype=np.float32)
    np.fill_diagonal(p, confidence)
    scores: NDArray[np.float32] = np.log(np.maximum(p @ member, np.float32(FLOOR)))
    scores[:, classes:] = padding
    return scores
