"""Detections in an image: the object in front, and eq 7 against products of distributions."""

from __future__ import annotations

import numpy as np
import pytest

from stages.kernels.image_detection import (
    SUREST,
    detect,
    foreground,
    pixels_in_other,
    share_of_box,
    share_of_other,
)
from stages.kernels.image_fusion import CAP
from stages.kernels.projection import fold_limit
from stages.kernels.warp import viewing_rays

C = 15
PERSON, VEHICLE = 5, 13
WIDTH, HEIGHT = 40, 30
INTRINSICS = np.array([35, 36, 19.5, 14.5, 0, 0, 0, 0, 0], np.float64)


def box(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    return np.array([x0, y0, x1, y1], np.float32)


def test_the_share_is_the_gaussian_of_eq_4() -> None:
    left, top, share = share_of_box(box(10, 4, 30, 24), WIDTH, HEIGHT)
    assert (left, top, share.shape) == (10, 4, (21, 21))
    assert share[10, 10] == pytest.approx(1.0)
    assert share[10, 0] == pytest.approx(0.607, abs=5e-4)
    assert share[0, 0] == pytest.approx(0.368, abs=5e-4)
    v, u = np.mgrid[4:25, 10:31]
    expected = np.exp(-0.5 * (((u - 20) / 10) ** 2 + ((v - 14) / 10) ** 2))
    np.testing.assert_allclose(share, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("edges", "shape"),
    [
        ((-10, -10, 4.5, 3.5), (4, 5)),
        ((35.2, 28, 1e30, 1e30), (2, 4)),
        ((-1e30, -1e30, 1e30, 1e30), (HEIGHT, WIDTH)),
        ((7, 7, 7, 7), (1, 1)),
        ((7.2, 7.2, 7.8, 7.8), (0, 0)),
        ((20, 20, 10, 10), (0, 0)),
        ((50, 5, 60, 9), (5, 0)),
    ],
)
def test_a_box_is_cut_to_the_image(edges: tuple[float, ...], shape: tuple[int, int]) -> None:
    _, _, share = share_of_box(box(*edges), WIDTH, HEIGHT)
    assert share.shape == shape
    assert np.isfinite(share).all()


def scene() -> tuple[np.ndarray, np.ndarray]:
    """A person 5 m away in front of a wall at 10 m, seen through a box around him."""
    depth = np.full((20, 12), 10.0, np.float32)
    depth[2:20, 3:9] = 5.0
    return depth, np.full((20, 12), 0.8, np.float32)


def test_the_object_in_front_is_what_hangs_together_in_depth() -> None:
    depth, share = scene()
    np.testing.assert_array_equal(foreground(depth, share, 0.03), depth == 5)


def test_growth_follows_a_slope_and_ends_at_a_step() -> None:
    depth = np.array([[5.0, 5.1, 5.2, 5.3, 5.4, 5.6, 5.7, 5.8]], np.float32)
    members = foreground(depth, np.ones_like(depth), 0.03)  # tau = 0.03 * 5.1
    assert members.tolist() == [[True] * 5 + [False] * 3]


def test_neighbors_touch_along_edges_not_corners() -> None:
    depth = np.full((4, 4), 9.0, np.float32)
    depth[:2, :2] = depth[2:, 2:] = 5.0
    share = np.ones((4, 4), np.float32)
    share[0, 0] = 2.0
    members = foreground(depth, share, 0.03)
    assert members[:2, :2].all()
    assert members.sum() == 4


def test_a_speckle_in_front_does_not_take_the_seed() -> None:
    depth, share = scene()
    depth[0, 0] = 5.0
    share[2:, 3:9] = 0.9
    np.testing.assert_array_equal(np.flatnonzero(foreground(depth, share, 0.03)[0]), [])


def test_holes_in_the_depth_of_an_object_belong_to_it_and_those_beside_it_do_not() -> None:
    depth, share = scene()
    depth[8:12, 5:7] = 0.0
    depth[8:12, 0:2] = 0.0
    members = foreground(depth, share, 0.03)
    assert members[8:12, 5:7].all()
    assert not members[8:12, 0:2].any()


def test_without_any_depth_the_whole_box_is_the_object() -> None:
    share = np.array([[0.5, 0.0], [0.7, 0.9]], np.float32)
    members = foreground(np.zeros((2, 2), np.float32), share, 0.03)
    np.testing.assert_array_equal(members, share > 0)


def state(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    fused = rng.dirichlet(np.ones(C), (HEIGHT, WIDTH)).astype(np.float32).transpose(0, 2, 1).copy()
    return fused, fused.argmax(axis=1).astype(np.uint8), fused.max(axis=1)


def test_a_detection_is_the_product_of_eq_7_on_its_members_and_nothing_elsewhere() -> None:
    fused, mask, confidence = state()
    before = fused.copy()
    left, top, share = share_of_box(box(5, 5, 25, 20), WIDTH, HEIGHT)
    members = np.random.default_rng(1).random(share.shape) < 0.6
    claimed = np.zeros((HEIGHT, WIDTH), np.uint16)
    detect(fused, mask, confidence, claimed, left, top, share, members, 0.9, PERSON)

    changed = np.zeros((HEIGHT, WIDTH), bool)
    changed[top : top + share.shape[0], left : left + share.shape[1]] = members
    s = np.zeros((HEIGHT, WIDTH))
    s[top : top + share.shape[0], left : left + share.shape[1]] = 0.9 * share.astype(np.float64)
    evidence = np.repeat(((1 - s) / (C - 1))[:, None], C, axis=1)
    evidence[:, PERSON] = s
    product = before.astype(np.float64) * evidence
    product /= product.sum(axis=1, keepdims=True)
    even = float(CAP) / (C - 1)
    expected = np.where(changed[:, None], product * (1 - even * C) + even, before)
    np.testing.assert_allclose(fused, expected, atol=1e-6)
    np.testing.assert_array_equal(
        fused.transpose(1, 0, 2)[:, ~changed].T, before.transpose(0, 2, 1)[~changed]
    )
    np.testing.assert_array_equal(mask, fused.argmax(axis=1))
    np.testing.assert_array_equal(confidence, fused.max(axis=1))


def test_a_weak_detection_argues_neither_for_nor_against() -> None:
    fused, mask, confidence = state()
    before = fused.copy()
    left, top, share = share_of_box(box(5, 5, 25, 20), WIDTH, HEIGHT)
    claimed = np.zeros((HEIGHT, WIDTH), np.uint16)
    detect(fused, mask, confidence, claimed, left, top, share, share > 0, 1 / C, PERSON)
    np.testing.assert_array_equal(fused, before)


def test_only_the_first_box_of_a_class_counts_in_a_pixel_and_other_classes_add() -> None:
    left, top, share = share_of_box(box(5, 5, 25, 20), WIDTH, HEIGHT)
    results = []
    for labels in ((PERSON,), (PERSON, PERSON), (PERSON, VEHICLE)):
        fused, mask, confidence = state()
        claimed = np.zeros((HEIGHT, WIDTH), np.uint16)
        for label in labels:
            detect(fused, mask, confidence, claimed, left, top, share, share > 0, 0.6, label)
        results.append(fused)
    np.testing.assert_array_equal(results[0], results[1])
    assert np.abs(results[0] - results[2]).max() > 0.1


def test_certainty_is_bounded() -> None:
    fused, mask, confidence = state()
    left, top, share = share_of_box(box(0, 0, 39, 29), WIDTH, HEIGHT)
    for _ in range(20):
        claimed = np.zeros((HEIGHT, WIDTH), np.uint16)
        detect(fused, mask, confidence, claimed, left, top, share, share > 0, 5.0, PERSON)
    assert SUREST < fused.max() <= 1 - 0.999 * CAP
    np.testing.assert_allclose(fused.sum(axis=1), 1.0, atol=5e-6)


def test_another_camera_s_box_falls_on_the_pixels_whose_points_it_sees() -> None:
    depth = np.full((HEIGHT, WIDTH), 6.0, np.float32)
    depth[0] = 0.0
    rays = viewing_rays(WIDTH, HEIGHT, INTRINSICS)
    beside = np.eye(4)
    beside[0, 3] = -0.6  # its lens 0.6 m to the right: u is less by 35 * 0.6 / 6 = 3.5
    pixels = pixels_in_other(depth, rays, beside, INTRINSICS, fold_limit(INTRINSICS))
    assert np.isnan(pixels[0, 0]).all()
    np.testing.assert_allclose(pixels[0, 5], np.arange(WIDTH) - 3.5, atol=1e-4)
    np.testing.assert_allclose(pixels[1, 5], 5, atol=1e-4)
    left, top, share = share_of_other(box(10, 0, 20, 8), pixels)
    assert (left, top, share.shape) == (14, 1, (8, 10))  # u 10.5 .. 19.5
    assert share[3, 4] == pytest.approx(np.exp(-0.5 * (0.5 / 5) ** 2), abs=1e-4)


def test_a_box_that_falls_on_no_pixel_has_no_share() -> None:
    pixels = np.full((2, HEIGHT, WIDTH), np.nan, np.float32)
    assert share_of_other(box(0, 0, 99, 99), pixels)[2].size == 0
