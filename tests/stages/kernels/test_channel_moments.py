"""Statistics of range images against NumPy over all points at once."""

from __future__ import annotations

import numpy as np

from stages.kernels.channel_moments import adapted, mean_and_std, moments
from stages.kernels.range_image import fill_channels

MEAN = np.array([12.12, 10.88, 0.23, -1.04, 0.21], np.float32)


def test_statistics_of_parts_add_up_to_those_of_all() -> None:
    points = np.random.default_rng(0).normal(0, 5, (131_072, 3)).astype(np.float32)
    points[::7] = 0
    remission = np.linspace(0, 1, len(points), dtype=np.float32)
    raw = []
    for half in (slice(0, 65_536), slice(65_536, None)):
        nearest = np.arange(65_536, dtype=np.int32).reshape(64, 1024)
        none, one = np.zeros(5, np.float32), np.ones(5, np.float32)
        raw.append(moments(fill_channels(points[half], remission[half], nearest, none, one)))
    mean, std = mean_and_std(raw[0] + raw[1])
    kept = points.any(axis=1)
    p = points[kept].astype(np.float64)
    values = np.column_stack([np.linalg.norm(p, axis=1), p, remission[kept]])
    np.testing.assert_allclose(mean, values.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(std, values.std(axis=0), rtol=1e-4)
    np.testing.assert_array_equal(adapted(MEAN, mean), [*MEAN[:3], *mean[3:]])


def test_nothing_measured_and_a_channel_that_stands_still_divide_by_nothing() -> None:
    mean, std = mean_and_std(moments(np.zeros((5, 2, 3), np.float32)))
    assert mean.tolist() == [0] * 5
    assert std.tolist() == [1] * 5
    mean, std = mean_and_std(moments(np.full((4, 2, 3), 0.7, np.float32)))
    np.testing.assert_allclose(mean, 0.7)
    assert std.tolist() == [1] * 4


def test_a_network_without_remission_is_adapted_in_z_alone() -> None:
    own = np.arange(5, dtype=np.float32)
    np.testing.assert_array_equal(adapted(MEAN[:4], own), [*MEAN[:3], 3])


def test_remission_may_stay_the_networks() -> None:
    own = np.arange(5, dtype=np.float32)
    np.testing.assert_array_equal(adapted(MEAN, own, remission=False), [*MEAN[:3], 3, MEAN[4]])


def test_near_cells_may_be_left_out() -> None:
    channels = np.array([[[0.0, 0.5, 1.0, 3.0]], [[9, 9, 2, 4]]], np.float32)
    assert moments(channels).tolist() == [[3, 3], [4.5, 15], [10.25, 101]]
    assert moments(channels, 1.0).tolist() == [[2, 2], [4, 6], [10, 20]]
