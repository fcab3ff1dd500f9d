"""Where scores lie: held against a float64 oracle that follows a pixel through the network."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from stages.kernels.sampling import sample_scores
from stages.score_grid import ScoreGrid


def stretched_cell(grid: ScoreGrid, axis: int, pixel: int, length: int, cells: int) -> float:
    """The cell at the center of an image's pixel, by the definitions and in exact numbers.

    Stretched by s, pixel u lies at (u + 1/2) s - 1/2 of the input. With corners aligned cell 0 is
    its pixel 0 and the last cell its last pixel; else the cells divide it evenly.
    """
    size, half = grid.size[axis], Fraction(1, 2)
    at = (pixel + half) * Fraction(size, length) - half
    if grid.align_corners:
        cell = at * Fraction(cells - 1, size - 1)
    else:
        cell = (at + half) * Fraction(cells, size) - half
    return float(min(max(cell, Fraction(0)), Fraction(cells - 1)))


def sampled_cells(
    grid: ScoreGrid, size: tuple[int, int], cells: tuple[int, int], pixel: np.ndarray
) -> np.ndarray:
    """The (column, row) that the sampler reads at pixels, from a grid that holds its own places."""
    rows, columns = cells
    places = np.zeros((1, rows, columns, 16), np.float32)
    places[0, :, :, 0], places[0, :, :, 1] = np.meshgrid(np.arange(columns), np.arange(rows))
    rect = np.array([grid.rect((0, 0, *size), cells)], np.float32)
    values, covered = sample_scores(places, rect, 1.0, 0.0, pixel.astype(np.float32), 2)
    assert covered.all()
    return values[:, :2]


@pytest.mark.parametrize("stride", [8, 16])
def test_every_pixel_of_848_x_480_reads_its_own_place_of_a_network_of_849_x_481(
    stride: int,
) -> None:
    grid = ScoreGrid((849, 481), align_corners=True)
    cells = 480 // stride + 1, 848 // stride + 1
    v, u = np.mgrid[:480, :848]
    pixel = np.stack([u.ravel(), v.ravel()], axis=1)
    read = sampled_cells(grid, (848, 480), cells, pixel)
    assert np.abs(read - pixel / stride).max() < 2e-5  # two units of float32 at cell 106


@given(
    aligned=st.booleans(),
    size=st.tuples(st.integers(9, 600), st.integers(9, 600)),
    image=st.tuples(st.integers(9, 2000), st.integers(9, 2000)),
    cells=st.tuples(st.integers(2, 9), st.integers(2, 9)),
)
def test_any_pixel_reads_where_the_fitted_picture_puts_it(
    aligned: bool, size: tuple[int, int], image: tuple[int, int], cells: tuple[int, int]
) -> None:
    grid = ScoreGrid(size, aligned)
    assume(not grid.pads(image))
    width, height = image
    pixel = np.array([[0, 0], [width // 3, height // 2], [width - 1, height - 1]])
    expected = [
        [
            stretched_cell(grid, 0, u, width, cells[1]),
            stretched_cell(grid, 1, v, height, cells[0]),
        ]
        for u, v in pixel.tolist()
    ]
    np.testing.assert_allclose(sampled_cells(grid, image, cells, pixel), expected, atol=2e-5)


@given(
    aligned=st.booleans(),
    pixels=st.integers(1, 300),
    stride=st.integers(1, 9),
)
def test_the_taken_cells_of_a_label_map_reach_every_pixel(
    aligned: bool, pixels: int, stride: int
) -> None:
    grid = ScoreGrid((pixels, pixels), aligned, stride)
    taken = grid.taken(pixels)
    assert (np.diff(taken) >= 0).all()
    assert taken[-1] < pixels
    left, _, right, _ = grid.rect((0, 0, pixels, pixels), (pixels, pixels))
    assert left <= 0
    assert right >= pixels
    width = (right - left) / len(taken)
    middle = left + (np.arange(len(taken)) + 0.5) * width
    inner = taken[:-1]  # the last one may stand for what lies beyond the map
    assert np.abs(middle[: len(inner)] - (inner + 0.5)).max(initial=0) <= 0.5


def test_a_picture_a_pixel_short_is_padded_and_keeps_its_pixels() -> None:
    grid = ScoreGrid((849, 481), align_corners=True)
    picture = np.random.default_rng(0).integers(0, 256, (480, 848, 3), dtype=np.uint8)
    fitted = grid.fit(picture)
    assert fitted.shape == (481, 849, 3)
    np.testing.assert_array_equal(fitted[:480, :848], picture)
    np.testing.assert_array_equal(fitted[480, :848], picture[-1])
    np.testing.assert_array_equal(fitted[:480, 848], picture[:, -1])


@pytest.mark.parametrize(
    ("size", "aligned", "pads"),
    [
        ((848, 480), True, True),
        ((849, 480), True, True),
        ((849, 481), True, False),
        ((848, 480), False, False),
        ((850, 480), True, False),
        ((640, 480), True, False),
    ],
)
def test_only_a_picture_that_is_a_pixel_short_is_padded(
    size: tuple[int, int], aligned: bool, pads: bool
) -> None:
    assert ScoreGrid((849, 481), aligned).pads(size) is pads


def test_a_picture_of_the_inputs_size_is_passed_on_uncopied() -> None:
    picture = np.zeros((481, 849, 3), np.uint8)
    assert ScoreGrid((849, 481), align_corners=True).fit(picture) is picture
