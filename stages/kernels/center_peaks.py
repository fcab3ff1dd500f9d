"""Peaks of a heat map, as CenterNet marks the centers of objects."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

#: The eight cells around one, those that come earlier in the map first.
NEIGHBORS = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)]


def peaks(
    heat: NDArray[Any], candidates: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Row, column and class of the `candidates` that are the greatest of their 3x3 cells.

    `heat` (rows, columns, classes) of any type: a quantized map is compared as it is stored, where
    neighbors are often equal; of equal neighbors the first is the peak. NaN is never greater.
    """
    rows, columns = heat.shape[:2]
    row, column, kind = np.nonzero(candidates)
    value = heat[row, column, kind]
    is_peak = np.ones(len(row), dtype=np.bool_)
    for number, (down, right) in enumerate(NEIGHBORS):
        y, x = row + down, column + right
        inside = (y >= 0) & (y < rows) & (x >= 0) & (x < columns)
        other = heat[np.where(inside, y, row), np.where(inside, x, column), kind]
        earlier = number < len(NEIGHBORS) // 2
        is_peak &= ~(inside & ((other >= value) if earlier else (other > value)))
    return row[is_peak], column[is_peak], kind[is_peak]
