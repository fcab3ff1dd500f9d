from __future__ import annotations

import math

import numpy as np
import pytest
from head_oracle import Row, assert_found, decoded, real, sigmoid, stored
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import ModelError
from pipeline.model import Tensor, Tensors

HEAD = {"kind": "fastestdet", "class_map": {0: "person"}}


def slow_fastestdet(outputs: Tensors) -> list[Row]:
    """The authors' formula, cell after cell."""
    grid = real(outputs["grid"])
    rows, columns = grid.shape[:2]
    found: list[Row] = []
    for row in range(rows):
        for column in range(columns):
            objectness, tx, ty, tw, th, *likely = grid[row, column].tolist()
            best = int(np.argmax(likely))
            score = min(max(objectness, 0), 1) ** 0.6 * min(max(likely[best], 0), 1) ** 0.4
            x, y = (column + math.tanh(tx)) / columns, (row + math.tanh(ty)) / rows
            w, h = sigmoid(tw), sigmoid(th)
            found.append((x - w / 2, y - h / 2, x + w / 2, y + h / 2, best, score))
    return found


@pytest.mark.parametrize("dtype", ["float32", "int8", "uint8"])
@given(seed=st.integers(0, 10_000), min_score=st.floats(0.05, 0.95))
def test_every_cell_that_reaches_the_score_is_found(
    dtype: str, seed: int, min_score: float
) -> None:
    random = np.random.default_rng(seed)
    grid = random.normal(0, 1, (1, 4, 5, 8))
    grid[..., 0] = random.uniform(0, 1, grid.shape[:3])
    grid[..., 5:] = random.uniform(0, 1, (*grid.shape[:3], 3))
    outputs = {"grid": stored(grid, dtype)}
    assert_found(decoded(HEAD, outputs, min_score), slow_fastestdet(outputs), min_score)


def test_a_grid_without_classes_is_refused() -> None:
    with pytest.raises(ModelError, match="output 'grid' has shape"):
        decoded(HEAD, {"grid": Tensor(np.zeros((1, 4, 4, 5)))}, 0.5)
