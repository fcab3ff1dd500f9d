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
from stages.kernels.anchors import multiscale_anchors, ssd_anchors

PICTURE = (64, 48)
ANCHORS: dict[str, Any] = {"kind": "ssd", "maps": [[3, 4], 1], "scales": [0.3, 0.8]}
GENERATED = ssd_anchors([(3, 4), (1, 1)], [0.3, 0.8], (1.0, 2.0, 0.5, 3.0, 1 / 3), PICTURE)


def head(**more: Any) -> dict[str, Any]:
    return {"kind": "ssd", "anchors": ANCHORS, "class_map": {1: "person"}, **more}


def slow_ssd(outputs: Tensors, scores_are: str, background: bool) -> list[Row]:
    """Algorithms 2.2, anchor after anchor: (ty, tx, th, tw) by 10, 10, 5, 5; the best class."""
    found: list[Row] = []
    regressions = real(outputs["boxes"]).reshape(-1, 4)
    for anchor, (ty, tx, th, tw), logits in zip(
        GENERATED.tolist(), regressions.tolist(), real(outputs["scores"]), strict=True
    ):
        if scores_are == "softmax":
            scores = np.exp(logits) / np.exp(logits).sum()
        else:
            scores = sigmoid(logits) if scores_are == "sigmoid" else logits
        best = int(scores[background:].argmax()) + background
        ya, xa, ha, wa = anchor
        y, x = ty / 10 * ha + ya, tx / 10 * wa + xa
        h, w = ha * math.exp(th / 5), wa * math.exp(tw / 5)
        found.append((x - w / 2, y - h / 2, x + w / 2, y + h / 2, best, float(scores[best])))
    return found


@pytest.mark.parametrize("scores_are", ["sigmoid", "softmax", "probability"])
@pytest.mark.parametrize("background", [True, False])
@pytest.mark.parametrize("dtype", ["float32", "int8", "uint8"])
@given(seed=st.integers(0, 10_000), min_score=st.floats(0.05, 0.95))
def test_every_anchor_that_reaches_the_score_is_found(
    scores_are: str, background: bool, dtype: str, seed: int, min_score: float
) -> None:
    random = np.random.default_rng(seed)
    n, classes = len(GENERATED), 4
    scores = random.normal(-1, 2, (1, n, classes))
    if scores_are == "probability":
        scores = random.uniform(0, 1, (1, n, classes))
    outputs = {
        "boxes": stored(random.normal(0, 3, (1, n, 1, 4)), dtype),
        "scores": stored(scores, dtype),
    }
    found = decoded(head(scores=scores_are, background=background), outputs, min_score, PICTURE)
    assert_found(found, slow_ssd(outputs, scores_are, background), min_score)


@pytest.mark.parametrize("scores_are", ["sigmoid", "softmax", "probability"])
def test_cold_anchors_are_not_even_decoded(scores_are: str) -> None:
    scores = np.full((1, len(GENERATED), 3), 0, np.uint8)
    scores[..., 0] = 200
    scores[0, 5] = (20, 10, 250)
    outputs = {
        "boxes": Tensor(np.zeros((1, len(GENERATED), 4), np.uint8), 0.03, 117),
        "scores": Tensor(scores, 0.05 if scores_are != "probability" else 1 / 256, 0),
    }
    boxes, classes, _ = decoded(head(scores=scores_are), outputs, 0.6, PICTURE)
    assert len(boxes) == 1
    assert classes.tolist() == [2]


def test_multiscale_anchors_are_settings_like_the_others() -> None:
    anchors = {"kind": "multiscale", "levels": [4, 5], "ratios": [1.0, 2.0], "per_octave": 1}
    wanted = multiscale_anchors((4, 5), 4.0, (1.0, 2.0), 1, PICTURE)
    outputs = {
        "boxes": Tensor(np.zeros((1, len(wanted), 4), np.float32)),
        "scores": Tensor(np.full((1, len(wanted), 2), 9, np.float32)),
    }
    boxes, _, _ = decoded(head(anchors=anchors), outputs, 0.5, PICTURE)
    centers = (boxes[:, :2] + boxes[:, 2:]) / 2
    np.testing.assert_allclose(centers, wanted[:, 1::-1], atol=1e-6)


@pytest.mark.parametrize(
    ("boxes", "scores", "said"),
    [
        ((1, 9, 4), (1, 9, 2), r"output 'boxes' has shape \(1, 9, 4\), the head takes \(42, 4\)"),
        ((1, 42, 4), (1, 41, 2), "output 'scores' has shape"),
        ((1, 42, 4), (1, 42, 1), "output 'scores' has shape"),
    ],
)
def test_outputs_that_do_not_fit_the_anchors_are_refused(
    boxes: tuple[int, ...], scores: tuple[int, ...], said: str
) -> None:
    outputs = {"boxes": Tensor(np.zeros(boxes)), "scores": Tensor(np.zeros(scores))}
    with pytest.raises(ModelError, match=said):
        decoded(head(), outputs, 0.5, PICTURE)


def test_a_missing_output_is_named() -> None:
    with pytest.raises(ModelError, match="needs an output 'boxes', the registry names scores"):
        decoded(head(), {"scores": Tensor(np.zeros((1, 42, 2)))}, 0.5, PICTURE)


@pytest.mark.parametrize(
    ("anchors", "said"),
    [
        (
            {"kind": "ssd", "maps": [3, 1], "scales": [0.3]},
            "head.anchors: 2 maps need as many scales",
        ),
        ({"kind": "multiscale", "levels": [5, 3]}, "levels must rise and end at 12"),
        ({"kind": "multiscale", "levels": [3, 99]}, "not go from 3 to 99"),
    ],
)
def test_anchors_that_cannot_be_are_refused(anchors: dict[str, Any], said: str) -> None:
    with pytest.raises(ModelError, match=said):
        decoded(head(anchors=anchors), {}, 0.5, PICTURE)
