from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from stages.fused import FusedImage, FusionStatus
from stages.taxonomy import load_taxonomy
from stages.types import CHANNELS, ClassScores, Cloud, Detections, SemanticVoxels
from tools.comparing.comparison import COMPARISONS, Comparison

ROAD, VEHICLE = load_taxonomy().id("road"), load_taxonomy().id("vehicle")


def rows(labels: Any, logit: float = 4.0) -> Any:
    """Log scores (..., CHANNELS) whose likeliest class is the label."""
    scores = np.zeros((*np.shape(labels), CHANNELS), np.float32)
    np.put_along_axis(scores, np.asarray(labels)[..., None], logit, axis=-1)
    return scores


def scores(labels: Any, logit: float = 4.0, width: int = 64) -> ClassScores:
    """A grid (rows, columns) of labels over an image of 64 x 32, tile by tile `width` wide."""
    grid = rows(np.asarray(labels)[None], logit)
    rects = np.array([[0, 0, width, 32]], np.float32)
    return ClassScores(grid, rects, 1.0, 0, "camera", (64, 32))


def cloud(labels: Any, evidence: Any) -> Cloud:
    n = len(labels)
    points = np.zeros((n, 3), np.float32)
    return Cloud(points, rows(labels), np.asarray(evidence, np.bool_), None, "lidar")


def voxels(indices: Any, labels: Any) -> SemanticVoxels:
    n = len(labels)
    return SemanticVoxels(
        0.25,
        np.asarray(indices, np.int32).reshape(n, 3),
        np.zeros((n, 3), np.float32),
        rows(labels),
        np.ones(n, np.int32),
    )


def boxes(corners: Any, classes: Any, found: Any) -> Detections:
    return Detections(
        np.asarray(corners, np.float32).reshape(-1, 4),
        np.asarray(classes, np.int64),
        np.asarray(found, np.float32),
        "camera",
    )


def mask(labels: Any) -> FusedImage:
    labels = np.asarray(labels, np.uint8)
    full = np.ones(labels.shape, np.float32)
    return FusedImage(labels, full, None, "camera", FusionStatus(0), 0.0)


def compared(*pairs: tuple[Any, Any]) -> dict[str, Any]:
    comparison: Comparison = COMPARISONS[type(pairs[0][0])]()
    for a, b in pairs:
        comparison.add(comparison.digest(a), comparison.digest(b))
    return comparison.page()


SAME = (
    scores([[ROAD, VEHICLE]] * 2),
    cloud([ROAD, VEHICLE], [True, False]),
    voxels([[0, 0, 0], [1, 0, 0]], [ROAD, VEHICLE]),
    mask(np.full((16, 16), ROAD)),
)


@pytest.mark.parametrize("payload", SAME, ids=lambda payload: type(payload).__name__)
def test_the_same_agrees_with_itself(payload: Any) -> None:
    page = compared((payload, payload))
    assert page["same_label"] == page["mean_iou"] == 1.0
    assert page["confidence_difference"] == 0.0
    assert all(row["share_a"] == row["share_b"] for row in page["classes"])


def test_scores_of_another_stride_and_tiling_are_compared_pixel_by_pixel() -> None:
    coarse, fine = scores([[ROAD, VEHICLE]]), scores(np.repeat([[ROAD] * 4 + [VEHICLE] * 4], 4, 0))
    page = compared((coarse, fine))
    assert page["count"] == 8 * 16
    assert page["same_label"] == 1.0
    half = scores([[ROAD, VEHICLE]], width=32)  # sees the left half only
    assert compared((coarse, half))["same_label"] < 0.5


def test_labels_that_differ_are_counted_by_class() -> None:
    left, right = scores([[ROAD, ROAD, VEHICLE, VEHICLE]]), scores([[ROAD] * 4])
    page = compared((left, right), (left, left))
    assert page["count"] == 2 * 8 * 16
    assert page["same_label"] == pytest.approx(0.75)
    by_class = {row["class"]: row for row in page["classes"]}
    assert by_class["vehicle"]["iou"] == pytest.approx(0.5)
    assert by_class["road"]["iou"] == pytest.approx(2 / 3, abs=1e-4)
    assert by_class["vehicle"]["share_a"] == pytest.approx(0.5)
    assert by_class["vehicle"]["share_b"] == pytest.approx(0.25)


def test_the_confidence_of_the_same_labels_may_differ() -> None:
    page = compared((scores([[ROAD]], 4.0), scores([[ROAD]], 2.0)))
    assert page["same_label"] == 1.0
    p = [np.exp(x) / (np.exp(x) + len(load_taxonomy()) - 1) for x in (4.0, 2.0)]
    assert page["confidence_difference"] == pytest.approx(p[0] - p[1], abs=1e-3)


def test_a_cloud_is_compared_where_both_have_evidence() -> None:
    a = cloud([ROAD, VEHICLE, ROAD, ROAD], [1, 1, 1, 0])
    b = cloud([ROAD, ROAD, ROAD, VEHICLE], [1, 1, 0, 0])
    page = compared((a, b))
    assert page["evidence"] == {"both": 2, "only_a": 1, "only_b": 0, "neither": 1}
    assert (page["count"], page["same_label"]) == (2, 0.5)


def test_clouds_of_different_points_are_not_paired() -> None:
    page = compared((cloud([ROAD], [1]), cloud([ROAD, ROAD], [1, 1])))
    assert page["count"] == 0
    assert page["same_label"] is None


def test_maps_are_compared_by_voxel_whatever_their_order() -> None:
    a = voxels([[0, 0, 0], [-1, 2, 3], [5, 5, 5]], [ROAD, VEHICLE, ROAD])
    b = voxels([[-1, 2, 3], [9, 9, 9], [0, 0, 0]], [VEHICLE, ROAD, VEHICLE])
    page = compared((a, b))
    assert page["held"] == {"both": 2, "only_a": 1, "only_b": 1}
    assert (page["count"], page["same_label"]) == (2, 0.5)


def test_boxes_are_paired_and_their_scores_compared() -> None:
    a = boxes([[0, 0, 10, 10], [20, 0, 30, 10]], [VEHICLE, VEHICLE], [0.9, 0.6])
    b = boxes([[0, 0, 10, 9]], [VEHICLE], [0.8])
    page = compared((a, b), (b, b))
    assert (page["count_a"], page["count_b"], page["matched"]) == (3, 2, 2)
    assert page["score_difference"] == pytest.approx(-0.05)
    assert page["largest_score_difference"] == pytest.approx(0.1)
    (row,) = page["classes"]
    assert row["iou"] == pytest.approx(0.95)
    assert (row["best_only_a"], row["best_only_b"]) == (pytest.approx(0.6), None)


def test_no_boxes_at_all_are_no_agreement() -> None:
    empty = boxes([], [], [])
    page = compared((empty, empty))
    assert (page["matched"], page["mean_iou"], page["classes"]) == (0, None, [])
