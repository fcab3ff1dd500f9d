from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from head_oracle import Row, assert_found, decoded, real, stored
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import ModelError
from pipeline.model import Tensor, Tensors

PICTURE = (64, 48)
#: As YOLOv5, YOLOv8 (TensorFlow Lite) and YOLOX leave it.
FORMS: list[dict[str, Any]] = [
    {},
    {"objectness": False, "transposed": True, "unit": "parts"},
    {"strides": [8, 16, 32]},
]


def head(form: dict[str, Any]) -> dict[str, Any]:
    return {"kind": "yolo", "class_map": {0: "person"}, **form}


def slow_yolo(outputs: Tensors, form: dict[str, Any]) -> list[Row]:
    """The definition, row after row."""
    table = real(outputs["rows"])
    table = table.T if form.get("transposed") else table
    cells = [
        (column, row, stride)
        for stride in form.get("strides", [])
        for row in range(PICTURE[1] // stride)
        for column in range(PICTURE[0] // stride)
    ]
    found: list[Row] = []
    for number, (x, y, w, h, *rest) in enumerate(table.tolist()):
        objectness = rest.pop(0) if form.get("objectness", True) else 1.0
        best = int(np.argmax(rest))
        if cells:
            column, row, stride = cells[number]
            x, y = (x + column) * stride, (y + row) * stride
            w, h = math.exp(w) * stride, math.exp(h) * stride
        unit = (1, 1) if form.get("unit") == "parts" else PICTURE
        x, w, y, h = x / unit[0], w / unit[0], y / unit[1], h / unit[1]
        box = (x - w / 2, y - h / 2, x + w / 2, y + h / 2)
        found.append((*box, best, objectness * rest[best]))
    return found


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("dtype", ["float32", "int8", "uint8"])
@given(seed=st.integers(0, 10_000), min_score=st.floats(0.05, 0.95))
def test_every_row_that_reaches_the_score_is_found(
    form: dict[str, Any], dtype: str, seed: int, min_score: float
) -> None:
    random = np.random.default_rng(seed)
    count = 48 + 12 + 2 if "strides" in form else 20
    boxes = random.uniform(0, 1, (count, 4))
    rows = np.hstack([boxes, random.uniform(0, 1, (count, 4))])
    rows = rows.T if form.get("transposed") else rows
    outputs = {"rows": stored(rows[None], dtype)}
    found = decoded(head(form), outputs, min_score, PICTURE)
    assert_found(found, slow_yolo(outputs, form), min_score)


@pytest.mark.parametrize(
    ("form", "shape", "said"),
    [
        ({}, (1, 20, 5), r"takes \(n, 5 \+ classes\)"),
        ({"transposed": True, "objectness": False}, (1, 4, 20), r"takes \(4 \+ classes, n\)"),
        ({"strides": [8]}, (1, 47, 9), r"takes \(48, 5 \+ classes\)"),
        ({}, (1, 20), "output 'rows' has shape"),
    ],
)
def test_rows_of_another_shape_are_refused(
    form: dict[str, Any], shape: tuple[int, ...], said: str
) -> None:
    with pytest.raises(ModelError, match=said):
        decoded(head(form), {"rows": Tensor(np.zeros(shape))}, 0.5, PICTURE)
