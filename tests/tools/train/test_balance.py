from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

from tools.train.balance import class_biases


def _iou(said: np.ndarray, truth: np.ndarray, label: int) -> float:
    mine, true = said == label, truth == label
    return float((mine & true).sum() / (mine | true).sum())


def test_a_rare_class_that_is_said_too_often_is_said_less() -> None:
    random = np.random.default_rng(1)
    truth = (random.random(20_000) < 0.05).astype(np.uint8) + 1  # class 2 is rare
    logits = np.zeros((len(truth), 3), np.float32)
    logits[:, 2] = 1.0 + 1.5 * (truth == 2) + 0.7 * random.standard_normal(len(truth))
    logits[:, 0] = -9.0
    logits[:, 1] = 1.0
    bias = class_biases(logits, truth)
    before, after = logits.argmax(axis=1), (logits + bias).argmax(axis=1)
    assert bias[2] - bias[1] < 0
    assert _iou(after, truth, 2) > _iou(before, truth, 2) + 0.1


def test_classes_that_are_right_already_stay_as_they_are() -> None:
    truth = np.repeat(np.array([1, 2], np.uint8), 50)
    logits = 5 * np.eye(3, dtype=np.float32)[truth]
    np.testing.assert_array_equal(class_biases(logits, truth), 0)
