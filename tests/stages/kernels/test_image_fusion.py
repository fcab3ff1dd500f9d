"""The blend of eq 6 against a float64 oracle, the paper's worked numbers, and its laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.kernels.image_fusion import BLOCK, CAP, colorize, fuse_rows
from stages.kernels.sampling import sample_scores
from stages.taxonomy import load_taxonomy

C = 15
BACKGROUND, PERSON = 0, 5
SHARE = np.where(load_taxonomy().dynamic, 0.80, 0.25).astype(np.float32)
NO_PAST = np.zeros((0, 0), np.int32)


def fuse(
    grid: np.ndarray,
    rects: np.ndarray,
    size: tuple[int, int],
    past: np.ndarray | None = None,
    source: np.ndarray = NO_PAST,
    scale: float = 1.0,
    zero_point: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int, int]:
    """fuse_rows with its outputs: (classes, height, width), mask, confidence, both counts."""
    width, height = size
    fused = np.full((height, C, width), np.nan, np.float32)
    mask, confidence = np.full((height, width), 255, np.uint8), np.full((height, width), np.nan)
    before = fused if past is None else np.ascontiguousarray(past.transpose(1, 0, 2))
    confidence = confidence.astype(np.float32)
    counts = fuse_rows(
        grid,
        rects,
        scale,
        zero_point,
        SHARE,
        before,
        source,
        fused,
        mask,
        confidence,
    )
    return fused.transpose(1, 0, 2), mask, confidence, *counts


def whole(size: tuple[int, int]) -> np.ndarray:
    return np.array([[0, 0, *size]], np.float32)


def capped(p: np.ndarray) -> np.ndarray:
    even = float(CAP) / (C - 1)
    return p * (1 - even * C) + even


def oracle(
    grid: np.ndarray,
    rects: np.ndarray,
    size: tuple[int, int],
    past: np.ndarray | None,
    source: np.ndarray,
    scale: float,
    zero_point: float,
) -> np.ndarray:
    """Soft-max of the interpolated scores and eq 6, written out in float64."""
    width, height = size
    v, u = np.mgrid[:height, :width].astype(np.float32)
    pixel = np.stack([u.ravel(), v.ravel()], axis=1)
    logits, _ = sample_scores(grid, rects, scale, zero_point, pixel, C)
    logits = logits[:, :C].astype(np.float64)
    p = np.exp(np.maximum(logits - logits.max(axis=1, keepdims=True), np.log(1e-6)))
    p = (p / p.sum(axis=1, keepdims=True)).T
    if past is not None:
        alpha = SHARE.astype(np.float64)[:, None]
        flat = past.reshape(C, -1).astype(np.float64)[:, np.maximum(source.ravel(), 0)]
        blend = alpha * p + (1 - alpha) * flat
        p = np.where(source.ravel() >= 0, blend / blend.sum(axis=0), p)
    return capped(p).reshape(C, height, width)


def random_past(rng: np.random.Generator, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    width, height = size
    past = rng.dirichlet(np.ones(C), width * height).T.reshape(C, height, width)
    source = rng.integers(-1, width * height, (height, width)).astype(np.int32)
    return past.astype(np.float32), source


@pytest.mark.parametrize("kind", ["float", "int8", "uint8"])
@pytest.mark.parametrize("tiles", [1, 3])
def test_the_blend_is_eq_6_to_four_millionths(kind: str, tiles: int) -> None:
    rng = np.random.default_rng(tiles)
    size = (53, 31)
    scale, zero_point = 1.0, 0.0
    grid = rng.normal(0, 3, (tiles, 5, 7, 16)).astype(np.float32)
    if kind != "float":
        scale, zero_point = 0.07, (3.0 if kind == "int8" else 130.0)
        grid = rng.integers(-128, 128, grid.shape).astype(np.int8)
        grid = grid if kind == "int8" else grid.view(np.uint8)
    rects = whole(size)
    if tiles == 3:
        rects = np.array([[0, 0, 31, 31], [11, 0, 42, 31], [22, 0, 53, 31]], np.float32)
    past, source = random_past(rng, size)
    given_ = (grid, rects, size, past, source, scale, zero_point)
    fused, mask, confidence, spoiled, uncovered = fuse(*given_)
    expected = oracle(*given_)
    np.testing.assert_allclose(fused, expected, atol=4e-6)
    np.testing.assert_array_equal(mask, fused.argmax(axis=0))
    np.testing.assert_array_equal(confidence, fused.max(axis=0))
    assert (spoiled, uncovered) == (0, 0)


@pytest.mark.parametrize("cells", [(301, 4), (38, 2)])
def test_rows_wider_than_a_block_and_cells_that_are_pixels(cells: tuple[int, int]) -> None:
    rng = np.random.default_rng(8)
    size = (301, 4)
    assert size[0] > 2 * BLOCK
    grid = rng.normal(0, 4, (1, cells[1], cells[0], 16)).astype(np.float32)
    past, source = random_past(rng, size)
    source[:, BLOCK : 2 * BLOCK] = -1  # a block without a past
    given_ = (grid, whole(size), size, past, source, 1.0, 0.0)
    fused, mask, *_ = fuse(*given_)
    np.testing.assert_allclose(fused, oracle(*given_), atol=4e-6)
    np.testing.assert_array_equal(mask, fused.argmax(axis=0))


def test_a_tile_as_wide_as_the_image_may_lie_beside_it() -> None:
    rng = np.random.default_rng(9)
    size = (40, 6)
    grid = rng.normal(0, 3, (1, 6, 40, 16)).astype(np.float32)
    rects = np.array([[7, 0, 47, 6]], np.float32)
    given_ = (grid, rects, size, None, NO_PAST, 1.0, 0.0)
    np.testing.assert_allclose(fuse(*given_)[0], oracle(*given_), atol=4e-6)


def one_pixel(p: np.ndarray, before: np.ndarray | None) -> np.ndarray:
    """Eq 6 on a single pixel: probabilities (15,) now and before."""
    grid = np.zeros((1, 1, 1, 16), np.float32)
    grid[0, 0, 0, :C] = np.log(np.maximum(p, 1e-12))
    past = None if before is None else before.astype(np.float32).reshape(C, 1, 1)
    source = NO_PAST if before is None else np.zeros((1, 1), np.int32)
    return fuse(grid, whole((1, 1)), (1, 1), past, source)[0].reshape(C)


def two_classes(person: float) -> np.ndarray:
    p = np.zeros(C)
    p[PERSON], p[BACKGROUND] = person, 1 - person
    return p


def test_a_person_takes_a_pixel_of_pure_background_in_one_image_only_from_0_953() -> None:
    for person, winner in ((0.950, BACKGROUND), (0.956, PERSON)):
        assert one_pixel(two_classes(person), two_classes(0.0)).argmax() == winner


def test_a_person_of_0_9_takes_a_background_pixel_in_the_second_image() -> None:
    first = one_pixel(two_classes(0.9), two_classes(0.0))
    second = one_pixel(two_classes(0.9), first)
    assert first[PERSON] == pytest.approx(0.48, abs=0.005)
    assert second[PERSON] == pytest.approx(0.66, abs=0.005)


def test_a_person_that_left_decays_within_three_images() -> None:
    p = two_classes(1.0)
    seen = []
    for _ in range(3):
        p = one_pixel(two_classes(0.02), p)
        seen.append(p[PERSON])
    assert seen == pytest.approx([0.47, 0.15, 0.05], abs=0.005)


def test_no_probability_exceeds_the_cap_and_none_is_zero() -> None:
    p = two_classes(1.0)
    for _ in range(50):
        p = one_pixel(two_classes(1.0), p)
    assert p.max() <= 1 - 0.999 * CAP
    assert p.min() > 0


@settings(deadline=None, max_examples=60)  # the first example compiles
@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 9))
def test_each_pixel_sums_to_one(seed: int, width: int, height: int) -> None:
    rng = np.random.default_rng(seed)
    grid = rng.normal(0, 10 ** rng.uniform(-2, 3), (1, 3, 2, 16)).astype(np.float32)
    past, source = random_past(rng, (width, height))
    fused = fuse(grid, whole((width, height)), (width, height), past, source)[0]
    np.testing.assert_allclose(fused.sum(axis=0), 1.0, atol=2e-6)


def test_a_constant_added_to_all_scores_changes_nothing() -> None:
    rng = np.random.default_rng(3)
    grid = rng.normal(0, 2, (1, 4, 4, 16)).astype(np.float32)
    level = np.float32(50)
    one, other = (fuse(g, whole((9, 9)), (9, 9))[0] for g in (grid, grid + level))
    np.testing.assert_allclose(one, other, atol=2e-5)


def test_what_agrees_with_the_past_stays() -> None:
    p = np.full(C, 1 / C)
    np.testing.assert_allclose(one_pixel(p, p), p, atol=1e-6)


def test_all_equal_scores_are_background() -> None:
    fused, mask, *_ = fuse(np.zeros((1, 2, 2, 16), np.float32), whole((4, 4)), (4, 4))
    assert (mask == BACKGROUND).all()
    np.testing.assert_allclose(fused, 1 / C, atol=1e-6)


def test_a_spoiled_cell_says_nothing_and_is_counted() -> None:
    grid = np.zeros((1, 1, 4, 16), np.float32)
    grid[0, 0, :, PERSON] = 5.0
    grid[0, 0, 1, 2] = np.nan
    grid[0, 0, 2, 3] = np.inf
    grid[0, 0, 3, 4] = -np.inf  # "impossible" is a sound thing to say
    fused, mask, _, spoiled, _ = fuse(grid, whole((4, 1)), (4, 1))
    assert spoiled == 2
    assert mask.tolist() == [[PERSON, BACKGROUND, BACKGROUND, PERSON]]
    np.testing.assert_allclose(fused[:, 0, 1:3], 1 / C, atol=1e-6)
    assert 0 < fused[4, 0, 3] < 1e-4


def test_pixels_outside_all_tiles_are_uniform_and_counted() -> None:
    grid = np.zeros((2, 1, 1, 16), np.float32)
    grid[..., PERSON] = 5.0
    rects = np.array([[0, 0, 2, 2], [2, 0, 4, 2]], np.float32)
    fused, mask, *_, uncovered = fuse(grid, rects, (6, 2))
    assert uncovered == 4
    assert mask.tolist() == [[PERSON] * 4 + [BACKGROUND] * 2] * 2
    np.testing.assert_allclose(fused[:, :, 4:], 1 / C, atol=1e-6)


@pytest.mark.parametrize(
    "rect", [[np.nan] * 4, [0, 0, 0, 0], [3, 3, 1, 1], [0, 0, np.inf, 4], [-np.inf, 0, 4, 4]]
)
def test_a_rectangle_without_sense_covers_nothing_or_something_but_never_spoils(
    rect: list[float],
) -> None:
    grid = np.ones((1, 2, 2, 16), np.float32)
    fused = fuse(grid, np.array([rect], np.float32), (4, 4))[0]
    np.testing.assert_allclose(fused.sum(axis=0), 1.0, atol=2e-6)


def test_colors_are_those_of_the_mask() -> None:
    colors = load_taxonomy().colors
    mask = np.arange(C, dtype=np.uint8).reshape(3, 5)
    np.testing.assert_array_equal(colorize(mask, colors), colors[mask])
