from __future__ import annotations

import numpy as np
import pytest
from head_oracle import decoded

from pipeline.errors import ModelError
from pipeline.model import Tensor

HEAD = {"kind": "ssd_postprocessed", "class_map": {0: "person"}}


def outputs(count: float) -> dict[str, Tensor]:
    boxes = np.array([[[0.1, 0.2, 0.3, 0.4], [0.5, 0.6, 0.7, 0.8]]], np.float32)
    return {
        "boxes": Tensor(boxes),
        "classes": Tensor(np.array([[0, 2]], np.float32)),
        "scores": Tensor(np.array([[0.9, 0.6]], np.float32)),
        "count": Tensor(np.array([count], np.float32)),
    }


def test_y_comes_before_x() -> None:
    boxes, classes, scores = decoded(HEAD, outputs(2), 0.5)
    np.testing.assert_allclose(boxes, [[0.2, 0.1, 0.4, 0.3], [0.6, 0.5, 0.8, 0.7]], rtol=1e-6)
    assert classes.tolist() == [0, 2]
    np.testing.assert_allclose(scores, [0.9, 0.6], rtol=1e-6)


@pytest.mark.parametrize(
    ("count", "rows"), [(1, 1), (0, 0), (-1, 0), (3, 0), (float("nan"), 0), (float("inf"), 0)]
)
def test_rows_beyond_the_count_are_old_and_an_odd_count_means_none(count: float, rows: int) -> None:
    assert len(decoded(HEAD, outputs(count), 0.5)[0]) == rows


def test_outputs_of_different_lengths_are_refused() -> None:
    short = outputs(2) | {"scores": Tensor(np.zeros((1, 1), np.float32))}
    with pytest.raises(ModelError, match=r"output 'scores' has shape \(1, 1\), the head takes"):
        decoded(HEAD, short, 0.5)
