"""Which voxels of a map somebody asks for: by place, class, confidence and entropy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import as_input
from stages.kernels.probability import read_out


def select(
    positions: NDArray[np.float32],
    log_scores: NDArray[np.float32],
    classes: int,
    *,
    box: tuple[Sequence[float], Sequence[float]] | None = None,
    center: Sequence[float] | None = None,
    radius_m: float = np.inf,
    labels: Sequence[int] | None = None,
    without: Sequence[int] = (),
    min_confidence: float = 0.0,
    max_entropy: float = np.inf,
) -> NDArray[np.int64]:
    """Rows (k,) of the voxels for which all holds, in the map's order.

    `positions` (n, 3) m, `log_scores` (n, 16). `box` lowest and highest corner, inclusive; within
    `radius_m` of `center`; likeliest class among `labels` (None: any) and not among `without` (the
    dynamic classes: what moved by is left out at reading, the map keeps it); probability of that
    class at least `min_confidence`; entropy at most `max_entropy` nats.
    """
    near = np.ones(len(positions), dtype=np.bool_)
    if box is not None:
        lowest, highest = np.asarray(box[0]), np.asarray(box[1])
        near &= ((positions >= lowest) & (positions <= highest)).all(axis=1)
    if center is not None:
        offset = positions - np.asarray(center, dtype=np.float64)
        near &= np.einsum("ij,ij->i", offset, offset) <= radius_m**2
    rows = np.flatnonzero(near)
    label, confidence, entropy = read_out(as_input(log_scores[rows]), classes)
    asked = np.ones(16, dtype=np.bool_) if labels is None else np.zeros(16, dtype=np.bool_)
    if labels is not None:
        asked[list(labels)] = True
    asked[list(without)] = False
    kept = asked[label] & (confidence >= min_confidence) & (entropy <= max_entropy)
    return np.asarray(rows[kept], dtype=np.int64)
