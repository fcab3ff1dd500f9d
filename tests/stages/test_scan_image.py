"""Scans as range images: which are taken as they are and which are projected."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from stages.scan_image import RangeImage
from stages.types import Scan

OS0 = (-np.pi / 4, np.pi / 4)
NONE, ONE = np.zeros(5, np.float32), np.ones(5, np.float32)


def scan(
    half_deg: float = 45.0, turned: int = 0, size: tuple[int, int] = (128, 1024), r: float = 8.0
) -> Scan:
    """A sphere of radius r seen over +-half_deg; its first column `turned` columns on."""
    half, (rows, columns) = np.radians(half_deg), size
    elevation = half - (np.arange(rows)[:, None] + 0.5) * 2 * half / rows
    azimuth = np.pi - (np.arange(columns) + turned + 0.5) * 2 * np.pi / columns
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    points = np.stack([x, y, np.broadcast_to(np.sin(elevation), x.shape)], axis=-1) * r
    points = points.reshape(-1, 3).astype(np.float32)
    return Scan(points, np.full(len(points), 0.5, np.float32), None, size, "lidar")


def test_an_organized_scan_that_looks_where_the_image_does_is_taken_as_it_is(
    caplog: pytest.LogCaptureFixture,
) -> None:
    image, given = RangeImage((64, 512), OS0), scan()
    planes = image.channels(given, NONE, ONE)
    every_second = given.points.reshape(128, 1024, 3)[::2, ::2].transpose(2, 0, 1)
    np.testing.assert_array_equal(planes[1:4], every_second)
    np.testing.assert_allclose(planes[0], 8.0, rtol=1e-6)
    assert (planes[4] == 0.5).all()
    _, cell, distance = image.places(given)
    by_hand = np.arange(128)[:, None] // 2 * 512 + np.arange(1024) // 2
    np.testing.assert_array_equal(cell.reshape(128, 1024), by_hand)
    np.testing.assert_allclose(distance, 8.0, rtol=1e-6)
    assert not caplog.records


@pytest.mark.parametrize("other", [{"half_deg": 21.0}, {"turned": 32}])
def test_one_that_looks_elsewhere_is_projected_and_said_once(
    other: dict[str, float], caplog: pytest.LogCaptureFixture
) -> None:
    image, given = RangeImage((64, 512), OS0), scan(**other)  # type: ignore[arg-type]
    with caplog.at_level(logging.WARNING):
        _, cell, _ = image.places(given)
        image.places(given)
    _, projected, _ = RangeImage((64, 512), OS0, organized=False).places(given)
    np.testing.assert_array_equal(cell, projected)
    assert len(caplog.records) == 1
    assert "scans of 128 x 1024 from 'lidar' look elsewhere" in caplog.text


def test_a_scan_too_near_or_too_empty_to_tell_decides_nothing() -> None:
    image = RangeImage((64, 512), OS0)
    near, empty = scan(half_deg=21.0, r=2.0), scan(half_deg=21.0)
    empty.points[50:] = 0
    for given in (near, empty):
        assert image.places(given)[1][-1] == 64 * 512 - 1
    assert image.places(scan(half_deg=21.0))[1][-1] != 64 * 512 - 1


def test_a_scan_of_another_shape_or_without_one_is_projected() -> None:
    image = RangeImage((64, 512), OS0)
    for given in (scan(size=(8, 2048)), scan(size=(100, 1024))):
        _, cell, _ = image.places(given)
        _, projected, _ = RangeImage((64, 512), OS0, organized=False).places(given)
        np.testing.assert_array_equal(cell, projected)


@pytest.mark.parametrize("organized", [True, False])
def test_what_lies_beyond_the_range_limit_is_no_return(organized: bool) -> None:
    given = scan()
    upper = slice(0, 64 * 1024)
    given.points[upper] *= 4  # 32 m away
    image = RangeImage((64, 512), OS0, 20.0, organized=organized)
    planes = image.channels(given, NONE, ONE)
    assert not planes[:, :32].any()
    assert planes[0, 32:].all()
    _, cell, distance = image.places(given)
    seen = (cell >= 0) & (distance > 0)
    assert not seen[upper].any()
    assert seen[64 * 1024 :].all()


def test_lost_columns_have_no_return() -> None:
    given = scan()
    given.points.reshape(128, 1024, 3)[:, 100:200] = 0
    planes = RangeImage((64, 512), OS0).channels(given, NONE, ONE)
    assert not planes[:, :, 50:100].any()
    assert planes[0, :, :50].all()
    assert planes[0, :, 100:].all()


def test_a_scan_without_remission_shows_the_mean() -> None:
    given = scan()
    without = Scan(given.points, None, None, given.shape, "lidar")
    planes = RangeImage((64, 512), OS0).channels(without, np.full(5, 0.2, np.float32), ONE)
    assert not planes[4].any()
