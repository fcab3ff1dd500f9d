from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from head_oracle import Row, assert_found, decoded, real, sigmoid, stored
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import ModelError
from pipeline.model import Tensor, Tensors

#: As in the paper, and as its descendants have it.
FORMS: list[dict[str, Any]] = [
    {},
    {"heat": "probability", "order": "yx", "log_size": True, "cell_center": 0.5},
]


def head(form: dict[str, Any]) -> dict[str, Any]:
    return {"kind": "centernet", "class_map": {0: "person"}, **form}


def slow_centernet(outputs: Tensors, form: dict[str, Any]) -> list[Row]:
    """The definition, cell after cell: a peak is not exceeded in its 3x3 cells; ties to the
    first."""
    heat, sizes, offsets = (real(outputs[name]) for name in ("heat", "size", "offset"))
    rows, columns, classes = heat.shape
    found: list[Row] = []
    for row in range(rows):
        for column in range(columns):
            for kind in range(classes):
                value = heat[row, column, kind]
                around = [
                    (r, c)
                    for r in range(max(row - 1, 0), min(row + 2, rows))
                    for c in range(max(column - 1, 0), min(column + 2, columns))
                ]
                if any(
                    heat[r, c, kind] >= value
                    if (r, c) < (row, column)
                    else heat[r, c, kind] > value
                    for r, c in around
                    if (r, c) != (row, column)
                ):
                    continue
                score = value if form.get("heat") == "probability" else sigmoid(value)
                turn = -1 if form.get("order") == "yx" else 1
                w, h = sizes[row, column][::turn].tolist()
                dx, dy = offsets[row, column][::turn].tolist()
                if form.get("log_size"):
                    w, h = math.exp(w), math.exp(h)
                shift = form.get("cell_center", 0.0)
                x, y = (column + shift + dx) / columns, (row + shift + dy) / rows
                w, h = w / columns, h / rows
                found.append((x - w / 2, y - h / 2, x + w / 2, y + h / 2, kind, float(score)))
    return found


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("dtype", ["float32", "int8", "uint8"])
@given(seed=st.integers(0, 10_000), min_score=st.floats(0.05, 0.95), smooth=st.booleans())
def test_every_peak_that_reaches_the_score_is_found(
    form: dict[str, Any], dtype: str, seed: int, min_score: float, smooth: bool
) -> None:
    random = np.random.default_rng(seed)
    heat = random.uniform(0, 1, (1, 5, 6, 2)) if form else random.normal(-1, 3, (1, 5, 6, 2))
    if smooth:  # many equal neighbors
        heat = np.round(heat)
    outputs = {
        "heat": stored(heat, dtype),
        "size": stored(random.uniform(0, 2, (1, 5, 6, 2)), dtype),
        "offset": stored(random.uniform(-0.5, 1, (1, 5, 6, 2)), dtype),
    }
    found = decoded(head(form), outputs, min_score)
    assert_found(found, slow_centernet(outputs, form), min_score)


def test_maps_of_different_sizes_are_refused() -> None:
    outputs = {
        "heat": Tensor(np.ones((1, 4, 4, 1), np.float32)),
        "offset": Tensor(np.zeros((1, 4, 3, 2), np.float32)),
        "size": Tensor(np.zeros((1, 4, 4, 2), np.float32)),
    }
    with pytest.raises(ModelError, match=r"output 'offset' has shape .*takes \(4, 4, 2\)"):
        decoded(head({}), outputs, 0.5)
