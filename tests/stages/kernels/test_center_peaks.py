from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stages.kernels.center_peaks import peaks


def all_peaks(heat: Any) -> set[tuple[int, ...]]:
    candidates = np.ones(heat.shape, np.bool_)
    return set(zip(*(index.tolist() for index in peaks(heat, candidates)), strict=True))


def slow_peaks(heat: Any) -> set[tuple[int, ...]]:
    """Cells that no neighbor of their class exceeds, by looking at each."""
    rows, columns, classes = heat.shape
    found: set[tuple[int, ...]] = set()
    for r in range(rows):
        for c in range(columns):
            for k in range(classes):
                around = heat[max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2, k]
                if heat[r, c, k] >= around.max():
                    found.add((r, c, k))
    return found


@given(
    seed=st.integers(0, 10_000),
    shape=st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 3)),
    dtype=st.sampled_from(["float32", "int8", "uint8"]),
)
def test_peaks_are_the_greatest_of_their_neighborhood(
    seed: int, shape: tuple[int, int, int], dtype: str
) -> None:
    random = np.random.default_rng(seed)
    # Different values, so that there is one answer.
    heat = random.permutation(int(np.prod(shape))).reshape(shape) - 50
    assert all_peaks(heat.astype(dtype)) == slow_peaks(heat.astype(dtype))


@given(seed=st.integers(0, 10_000))
def test_of_equal_neighbors_exactly_one_is_a_peak(seed: int) -> None:
    """Quantized maps are full of them; a plateau of two cells is one object, not two or none."""
    random = np.random.default_rng(seed)
    heat = np.zeros((5, 5, 1), np.uint8)
    row, column = random.integers(1, 4, 2)
    down, right = [(0, 1), (1, 0), (1, 1), (1, -1)][random.integers(4)]
    heat[row, column] = heat[row + down, column + right] = 9
    found = all_peaks(heat)
    assert len({cell for cell in found if heat[cell] == 9}) == 1


def test_a_flat_map_has_its_first_cell_as_its_peak() -> None:
    assert all_peaks(np.full((4, 3, 1), 7, np.int8)) == {(0, 0, 0)}


def test_nan_neither_is_a_peak_of_candidates_nor_hides_one() -> None:
    heat = np.array([[0.1, np.nan, 0.9, np.nan]], np.float32)[..., None]
    row, column, kind = peaks(heat, heat >= 0.5)
    assert (row.tolist(), column.tolist(), kind.tolist()) == ([0], [2], [0])


@pytest.mark.parametrize("shape", [(0, 0, 1), (1, 1, 1), (0, 3, 2)])
def test_tiny_maps(shape: tuple[int, int, int]) -> None:
    assert len(all_peaks(np.zeros(shape, np.float32))) == (1 if shape == (1, 1, 1) else 0)
