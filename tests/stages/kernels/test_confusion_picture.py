"""The picture holds a cell for each class that is or was predicted."""

from __future__ import annotations

import numpy as np

from stages.kernels.confusion_picture import CELL, draw_confusion
from stages.kernels.render import PAPER

NAMES = ["background", "building", "road", "person"]


def test_rows_are_true_classes_columns_all_predicted_ones_and_hits_are_dark() -> None:
    matrix = np.zeros((4, 4), np.int64)
    matrix[1, 1], matrix[1, 3], matrix[2, 2] = 90, 10, 5
    picture = draw_confusion(matrix, NAMES)
    smaller = draw_confusion(matrix * (np.arange(4) != 3), NAMES)  # nobody says person
    assert picture.shape[1] - smaller.shape[1] in (0, CELL)
    assert picture.shape[0] == smaller.shape[0], "two true classes in both"
    assert picture.dtype == np.uint8
    assert (picture == (16, 64, 144)).all(axis=2).sum() > CELL * CELL / 2, "road: all hits"


def test_nothing_judged_is_an_empty_sheet() -> None:
    picture = draw_confusion(np.zeros((4, 4), np.int64), NAMES)
    assert (picture == PAPER).mean() > 0.8
