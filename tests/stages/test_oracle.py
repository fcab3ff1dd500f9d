"""Stages that say what is true: right at every pixel and return, or wrong as often as asked."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import StageError
from pipeline.message import Message
from stages.kernels.probability import softmax
from stages.kernels.sampling import sample_scores
from stages.labels import Labels
from stages.oracle import TrueCloud, TrueScores, log_odds
from stages.taxonomy import load_taxonomy
from stages.types import Scan

CLASSES = len(load_taxonomy())


def labeled(classes: np.ndarray, sensor: str = "rgb") -> Message[Labels]:
    kinds = classes.astype(np.uint8)
    return Message.at(5, Labels(kinds, np.zeros(kinds.shape, np.uint16), sensor))


def scanned(rows: int, columns: int) -> Message[Scan]:
    points = np.random.default_rng(0).normal(0, 5, (rows * columns, 3)).astype(np.float32)
    times = np.arange(rows * columns, dtype=np.int32)
    return Message.at(5, Scan(points, None, times, (rows, columns), "lidar"))


def test_scores_at_the_center_of_a_pixel_give_its_class_the_claimed_probability() -> None:
    classes = np.random.default_rng(0).integers(0, CLASSES, (6, 9))
    scores = TrueScores(confidence=0.9).process(labeled(classes))
    v, u = np.mgrid[:6, :9].astype(np.float32)
    pixel = np.stack([u.ravel(), v.ravel()], axis=1)
    rows, said = sample_scores(scores.grid, scores.rects, scores.scale, 0.0, pixel, CLASSES)
    assert said.all()
    assert (scores.size, scores.camera) == ((9, 6), "rgb")
    claimed = softmax(rows, CLASSES)[np.arange(54), classes.ravel()]
    assert claimed == pytest.approx(0.9, abs=1e-5)


def test_a_cloud_has_the_class_of_every_return_and_nothing_where_there_is_none() -> None:
    classes = np.array([[3, 0, 5], [13, 1, 0]])
    scan = scanned(2, 3)
    cloud = TrueCloud(confidence=0.99).process(scan, labeled(classes, "lidar"))
    assert cloud.evidence.tolist() == (classes.ravel() > 0).tolist()
    sure = softmax(cloud.log_scores, CLASSES)[np.arange(6), classes.ravel()]
    assert sure[cloud.evidence] == pytest.approx(0.99, abs=1e-5)
    assert cloud.times_ns is scan.payload.times_ns
    assert cloud.shape == (2, 3)


def test_mistakes_are_as_frequent_as_asked_and_never_background() -> None:
    classes = np.full((100, 100), 4)
    stage = TrueCloud(mistakes=0.3, confidence=0.7)
    cloud = stage.process(scanned(100, 100), labeled(classes))
    said = cloud.log_scores[:, :CLASSES].argmax(axis=1)
    assert (said != 4).mean() == pytest.approx(0.3, abs=0.02)
    assert set(said) == set(range(1, CLASSES))
    again = stage.process(scanned(100, 100), labeled(classes))
    assert (again.log_scores == cloud.log_scores).all()


def test_labels_of_another_scan_are_refused() -> None:
    with pytest.raises(StageError, match=r"6 labels of 'rgb' for the 4 points"):
        TrueCloud().process(scanned(2, 2), labeled(np.ones((2, 3))))


@pytest.mark.parametrize("confidence", [0.0, 1 / CLASSES, 1.0])
def test_a_confidence_without_odds_is_refused(confidence: float) -> None:
    with pytest.raises(ValueError, match="confidence must lie above"):
        log_odds(confidence)


def test_a_share_of_mistakes_is_below_one() -> None:
    with pytest.raises(ValueError, match="mistakes must be at least 0 and below 1"):
        TrueCloud(mistakes=1.0)
