"""Gain control of 16-bit thermal frames."""

from __future__ import annotations

import numpy as np
import pytest

from stages.kernels.thermal import (
    apply_table,
    equalize_locally,
    histogram,
    linear_table,
    plateau_table,
    quantiles,
)


def frame(low: int = 7000, high: int = 7400, shape: tuple[int, int] = (64, 80)) -> np.ndarray:
    return np.random.default_rng(0).integers(low, high, shape).astype(np.uint16)


def test_quantiles_are_those_of_the_sorted_counts_without_dead_pixels() -> None:
    raw = frame()
    raw[0, :40], raw[1, :40] = 0, 65535
    alive = np.sort(raw[(raw > 0) & (raw < 65535)])
    expected = [alive[int(np.floor(q * (len(alive) - 1)))] for q in (0.01, 0.99)]
    assert quantiles(histogram(raw), 0.01, 0.99) == tuple(expected)


def test_a_frame_of_dead_pixels_has_no_quantiles() -> None:
    raw = np.zeros((4, 4), np.uint16)
    raw[2:] = 65535
    assert quantiles(histogram(raw), 0.01, 0.99) is None


def test_the_linear_table_stretches_its_range() -> None:
    table = linear_table(7000, 7100)
    raw = np.array([[0, 6999, 7000, 7050, 7100, 65535]], np.uint16)
    assert apply_table(raw, table).tolist() == [[0, 0, 0, 128, 255, 255]]


@pytest.mark.parametrize("high", [7000.0, 7000.5, 6000.0])
def test_without_contrast_everything_is_middle_gray(high: float) -> None:
    assert (apply_table(frame(), linear_table(7000, high)) == 128).all()
    constant = np.full((8, 8), 7000, np.uint16)
    assert (apply_table(constant, plateau_table(histogram(constant), 0.07, 4)) == 128).all()


def test_the_plateau_table_keeps_the_order_and_takes_the_whole_range() -> None:
    raw = frame()
    table = plateau_table(histogram(raw), 0.07, 4.0)
    assert (np.diff(table) >= 0).all()
    gray = apply_table(raw, table)
    assert (gray.min(), gray.max()) == (0, 255)


def test_the_plateau_leaves_detail_to_the_few_beside_an_even_surface() -> None:
    raw = frame(7000, 7100)
    raw[:50] = 6500  # sky: 78 % of the pixels in one count
    bounded = apply_table(raw, plateau_table(histogram(raw), 0.07, 4.0))[50:]
    equalized = apply_table(raw, plateau_table(histogram(raw), 1.0, 255.0))[50:]
    assert np.ptp(bounded.astype(int)) > 1.5 * np.ptp(equalized.astype(int))


def test_a_flat_frame_is_not_blown_up_into_noise() -> None:
    raw = frame(7000, 7006)
    gray = apply_table(raw, plateau_table(histogram(raw), 0.07, 4.0)).astype(int)
    assert np.ptp(gray) == 20  # 5 counts of at most 4 gray levels
    assert (gray.min() + gray.max()) / 2 == pytest.approx(127.5, abs=1)


def test_local_equalization_raises_local_contrast_and_leaves_a_constant() -> None:
    gray = np.tile(np.linspace(0, 200, 320), (256, 1)).astype(np.uint8)
    gray[96:160, 96:160] += 8

    def edge(picture: np.ndarray) -> float:
        return float(picture[96:100, 100:150].mean() - picture[92:96, 100:150].mean())

    assert edge(equalize_locally(gray, 4.0, 8)) > 1.5 * edge(gray)
    constant = np.full((64, 64), 128, np.uint8)
    np.testing.assert_array_equal(equalize_locally(constant, 3.0, 8), constant)
