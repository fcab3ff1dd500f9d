from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np
import pytest

from pipeline.stage import Source
from stages.sources.emulated import (
    EmulatedCamera,
    EmulatedLidar,
    EmulatedOdometry,
    EmulatedThermal,
)

ALL = [EmulatedCamera, EmulatedThermal, EmulatedLidar, EmulatedOdometry]


def opened(source: Source) -> Any:
    source.open()
    return source.messages()


@pytest.mark.parametrize("make", ALL)
def test_stamps_keep_rate_phase_and_count(make: Any) -> None:
    messages = list(opened(make(rate_hz=20, phase_ms=3, count=4)))
    assert [message.stamp for message in messages] == [
        3_000_000 + 50_000_000 * number for number in range(4)
    ]


@pytest.mark.parametrize("make", ALL)
def test_without_a_count_a_stream_has_no_end(make: Any) -> None:
    assert len(list(islice(opened(make()), 100))) == 100


@pytest.mark.parametrize("make", ALL[:3])
def test_every_message_carries_the_one_payload_read_only(make: Any) -> None:
    one, two = opened(make(count=2))
    assert one.payload is two.payload
    array = one.payload.data if hasattr(one.payload, "data") else one.payload.points
    assert not array.flags.writeable


def test_shapes_and_types_are_those_of_the_sensors() -> None:
    (rgb,) = opened(EmulatedCamera(count=1))
    assert (rgb.payload.data.shape, rgb.payload.data.dtype) == ((480, 848, 3), np.uint8)
    (thermal,) = opened(EmulatedThermal(count=1))
    assert (thermal.payload.data.shape, thermal.payload.data.dtype) == ((512, 640), np.uint8)
    assert thermal.payload.camera == "thermal"
    (scan,) = opened(EmulatedLidar(count=1))
    assert scan.payload.points.shape == (128 * 1024, 3)
    assert scan.payload.shape == (128, 1024)


def test_a_scan_is_stamped_mid_sweep_and_arrives_when_the_sweep_is_over() -> None:
    (scan,) = opened(EmulatedLidar(count=1, delay_ms=50, phase_ms=50))
    assert (scan.begin, scan.stamp, scan.end) == (0, 50_000_000, 100_000_000)
    assert scan.received == 100_000_000
    (late,) = opened(EmulatedLidar(count=1, delay_ms=60))
    assert late.received == 60_000_000
    times = scan.payload.times_ns
    assert times is not None
    assert (times.min(), times.max()) == (-50_000_000, 50_000_000)
    columns = times.reshape(scan.payload.shape)
    assert (columns == columns[0]).all()


def test_points_lie_in_their_row_and_column() -> None:
    (scan,) = opened(EmulatedLidar(count=1, rows=3, columns=4))
    points = scan.payload.points.reshape(3, 4, 3)
    np.testing.assert_allclose(np.linalg.norm(points, axis=-1), 10, rtol=1e-6)
    assert (points[0, :, 2] > 7).all()
    assert np.abs(points[1, :, 2]).max() < 1e-5


def test_the_vehicle_moves_at_its_speed() -> None:
    poses = list(opened(EmulatedOdometry(count=101, speed_m_s=2, rate_hz=100)))
    assert poses[-1].payload.map_from_base[0, 3] == pytest.approx(2.0)


def test_no_message_at_all_is_a_bad_option() -> None:
    with pytest.raises(ValueError, match="count must be at least 1"):
        EmulatedCamera(count=0)
