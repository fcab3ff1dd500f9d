"""Random numbers of a place are uniform, normal, smooth, and show no grid."""

from __future__ import annotations

import numpy as np
import pytest

from stages.simulation.noise import bell, chance, fractal_noise, scrambled, value_noise

PLACES = [(i, j) for i in range(120) for j in range(120)]


def test_chances_are_uniform() -> None:
    values = np.array([chance(i, j, 5) for i, j in PLACES])
    counts, _ = np.histogram(values, bins=16, range=(0, 1))
    assert counts == pytest.approx(len(PLACES) / 16, rel=0.15)


def test_chances_of_neighbors_know_nothing_of_each_other() -> None:
    values = np.array([chance(i, j, 5) for i, j in PLACES]).reshape(120, 120) - 0.5
    spectrum = np.abs(np.fft.fft2(values)) ** 2
    spectrum[0, 0] = 0.0
    # White noise has an exponential periodogram: a grid would be a peak far above its mean.
    assert spectrum.max() < 14 * spectrum.mean()


def test_normal_numbers_have_mean_0_and_variance_1() -> None:
    values = np.array([bell(scrambled(i, j, 9)) for i, j in PLACES])
    assert values.mean() == pytest.approx(0.0, abs=0.03)
    assert values.std() == pytest.approx(1.0, abs=0.02)


def test_value_noise_is_continuous_across_its_cells() -> None:
    for x in (3.0, -2.0, 0.0):
        assert value_noise(x - 1e-7, 0.3, 1) == pytest.approx(
            value_noise(x + 1e-7, 0.3, 1), abs=1e-5
        )


def test_detail_below_the_footprint_of_a_pixel_is_gone() -> None:
    fine = [fractal_noise(x, 0.2, 0.01, 4, 3) for x in np.linspace(0, 20, 200)]
    coarse = [fractal_noise(x, 0.2, 5.0, 4, 3) for x in np.linspace(0, 20, 200)]
    assert np.std(fine) > 0.05
    assert np.std(coarse) == 0.0
