"""Bayesian fusion of class evidence (eq 2, 3), in log scores up to a constant per row.

A row of log scores l stands for the distribution p = exp(l) / sum exp(l). The product of
distributions, normalized (eq 3), is then a plain sum of rows: the normalizers cancel, so nothing is
exponentiated before somebody asks for probabilities. Rows are 16 wide; channels from `classes` on
are padding.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled, prefetch_to_write

#: No source may veto a class forever: the least probability of a class, relative to its likeliest.
LEAST = 1e-6

LOG_LEAST = np.float32(np.log(LEAST))
PADDING = np.float32(-1e4)

#: So many rows ahead a point's row is asked for.
AHEAD = 32


@compiled
def bound_rows(log_scores: NDArray[np.float32], classes: int) -> Any:
    """Make a source's rows (m, 16) fit for the product, in place: maximum 0, least log 1e-6.

    The floor is relative to the greatest class, which needs no exponential and differs from a floor
    on the probability by less than a factor `classes`. A row without a finite maximum or with a NaN
    becomes uniform. Returns (m,) bool: the row was sound.
    """
    sound = np.ones(len(log_scores), dtype=np.bool_)
    for i in range(len(log_scores)):
        row = log_scores[i]
        top = row[0]
        for k in range(classes):
            sound[i] &= not np.isnan(row[k])
            top = max(top, row[k])
        sound[i] &= np.isfinite(top)
        if not sound[i]:
            row[:classes] = 0.0
            continue
        for k in range(classes):
            row[k] = max(row[k] - top, LOG_LEAST)
    return sound


@compiled
def uniform_rows(n: int, classes: int) -> Any:
    """(n, 16) float32 rows that say nothing: 0, and `PADDING` from `classes` on."""
    rows = np.empty((n, 16), dtype=np.float32)
    for i in range(n):
        for k in range(16):
            rows[i, k] = 0.0 if k < classes else PADDING
    return rows


@compiled
def accumulate(
    total: NDArray[np.float32],
    evidence: NDArray[np.bool_],
    index: NDArray[np.int64],
    rows: NDArray[np.float32],
    said: NDArray[np.bool_],
    classes: int,
) -> None:
    """Multiply the distributions `rows` (m, 16) into those of points `index` (m,), in place.

    Eq 2, 3: p = p_a p_b / sum p_a p_b, so `total` (n, 16) gets l_a + l_b. Only where `said` (m,);
    those points have `evidence` (n,) from then on.
    """
    for i in range(len(index)):
        if i + AHEAD < len(index):
            prefetch_to_write(total, index[i + AHEAD] * 16)
        if said[i]:
            point = np.uint64(index[i])
            evidence[point] = True
            for k in range(classes):
                total[point, k] += rows[i, k]


@compiled
def add_detection(
    total: NDArray[np.float32],
    evidence: NDArray[np.bool_],
    index: NDArray[np.int64],
    pixel: NDArray[np.float32],
    members: NDArray[np.int64],
    box: NDArray[np.float32],
    score: float,
    label: int,
    classes: int,
) -> None:
    """Multiply a detection's distribution (eq 4) into its member points, in place.

    A point at pixel u v has s = score exp(-((u - cx)^2 / sx^2 + (v - cy)^2 / sy^2) / 2), where sx,
    sy are half the box's width and height: p(label) = s, every other class (1 - s) / (C - 1). Up to
    a constant per point that is log((C - 1) s / (1 - s)) on channel `label`. s is held in
    [1 / C, 0.999]: a weak detection is neutral, it never argues against its class. `members` (j,)
    are the rows of `index` (m,) and `pixel` (m, 2) to treat.
    """
    center_x, center_y = 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])
    sigma_x = max(0.5 * (box[2] - box[0]), 0.5)  # at least a pixel: an empty box divides by 0
    sigma_y = max(0.5 * (box[3] - box[1]), 0.5)
    for member in members:
        a = (pixel[member, 0] - center_x) / sigma_x
        b = (pixel[member, 1] - center_y) / sigma_y
        s = min(max(score * np.exp(-0.5 * (a * a + b * b)), 1.0 / classes), 0.999)
        total[index[member], label] += np.float32(np.log((classes - 1) * s / (1.0 - s)))
        evidence[index[member]] = True


def softmax(log_scores: NDArray[np.float32], classes: int) -> NDArray[np.float32]:
    """Probabilities (..., classes) of log scores (..., 16)."""
    rows = log_scores[..., :classes]
    exponentials = np.exp(rows - rows.max(axis=-1, keepdims=True))
    return np.asarray(exponentials / exponentials.sum(axis=-1, keepdims=True))


@compiled
def read_out(log_scores: NDArray[np.float32], classes: int) -> Any:
    """What rows (n, 16) say: class (n,) uint8, probability (n,) float32, entropy (n,) float32.

    The likeliest class, ties to the lowest id; its probability; the entropy in nats.
    """
    n = len(log_scores)
    label = np.empty(n, dtype=np.uint8)
    confidence = np.empty(n, dtype=np.float32)
    entropy = np.empty(n, dtype=np.float32)
    for i in range(n):
        row = log_scores[i]
        best = 0
        for k in range(1, classes):
            if row[k] > row[best]:
                best = k
        total, moment = 0.0, 0.0  # sums of e^d and d e^d, with d <= 0 below the maximum
        for k in range(classes):
            d = row[k] - row[best]
            if d > -80.0:
                e = np.exp(d)
                total += e
                moment += d * e
        label[i] = best
        confidence[i] = 1.0 / total
        entropy[i] = np.log(total) - moment / total
    return label, confidence, entropy
