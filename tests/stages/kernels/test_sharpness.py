"""Sharpness of walls whose scatter is known."""

from __future__ import annotations

import numpy as np
import pytest

from stages.kernels.sharpness import sharpness

BUILDING, VEHICLE = 1, 13


def wall(scatter_m: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.c_[
        rng.uniform(0, 10, 6_000), rng.normal(0, scatter_m, 6_000), rng.uniform(0, 4, 6_000)
    ]


def test_a_smeared_wall_is_thicker_and_its_class_says_so() -> None:
    labels = np.full(6_000, BUILDING)
    sharp, by_class = sharpness(wall(0.02), labels, None, 0.25)
    smeared, _ = sharpness(wall(0.2), labels, None, 0.25)
    assert sharp.thickness_m == pytest.approx(0.02, rel=0.2)
    assert smeared.thickness_m > 5 * sharp.thickness_m
    assert by_class.keys() == {BUILDING}
    assert by_class[BUILDING].thickness_m == sharp.thickness_m
    assert np.isnan(sharp.disputed)


def test_the_ground_under_a_wall_makes_it_no_thicker() -> None:
    rng = np.random.default_rng(3)
    ground = np.c_[rng.uniform(0, 10, 6_000), rng.uniform(-2, 2, 6_000), rng.normal(0, 0.02, 6_000)]
    points = np.concatenate([wall(0.02), ground])
    labels = np.repeat([BUILDING, 3], 6_000)
    measured, _ = sharpness(points, labels, None, 0.25)
    assert measured.thickness_m == pytest.approx(0.02, rel=0.2)


def test_entropy_and_blobs_are_counted_by_class_and_specks_and_the_unlabeled_are_not() -> None:
    cube = np.stack(np.meshgrid(*[np.arange(3)] * 3), axis=-1).reshape(-1, 3) + 0.5
    points = np.concatenate([cube, cube + 10, cube[:5] + 20, cube + 30])
    labels = np.concatenate([np.full(27 + 27 + 5, VEHICLE), np.zeros(27, np.int64)])
    entropy = np.zeros(len(points), np.float32)
    entropy[:27], entropy[-27:] = 0.5, 9.0
    measured, by_class = sharpness(points, labels, entropy, 1.0)
    assert (measured.voxels, measured.blobs) == (59, 2)
    assert by_class[VEHICLE].disputed == pytest.approx(27 / 59)
    assert measured.entropy == pytest.approx(0.5 * 27 / 59)


def test_an_empty_map_measures_nothing() -> None:
    measured, by_class = sharpness(np.zeros((0, 3)), np.zeros(0, np.int64), None, 0.25)
    assert (measured.voxels, measured.blobs, by_class) == (0, 0, {})
    assert np.isnan(measured.thickness_m)
