from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np
import pytest

from pipeline.errors import DataError
from pipeline.stage import Source
from stages.emulated_street import read_classes
from stages.sources.emulated import (
    EmulatedCamera,
    EmulatedDepth,
    EmulatedLidar,
    EmulatedOdometry,
    EmulatedThermal,
)
from stages.taxonomy import load_taxonomy
from stages.types import Calibration

ALL = [EmulatedCamera, EmulatedDepth, EmulatedThermal, EmulatedLidar, EmulatedOdometry]
DOWN = Calibration.parse(
    {
        "belly": {
            "base_from_sensor": [[0, -1, 0, 0], [-1, 0, 0, 0], [0, 0, -1, 0]],
            "camera": {"size": [64, 48], "fx": 64, "fy": 64, "cx": 31.5, "cy": 23.5},
        },
        "lidar": {"base_from_sensor": {"translation": [0, 0, 1], "rotation_rpy_deg": [0, 0, 0]}},
    }
)


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


@pytest.mark.parametrize("make", ALL[:4])
def test_every_message_carries_the_one_payload_read_only(make: Any) -> None:
    one, two = opened(make(count=2))
    assert one.payload is two.payload
    fields = (getattr(one.payload, name) for name in one.payload.__dataclass_fields__)
    arrays = [field for field in fields if isinstance(field, np.ndarray)]
    assert arrays
    assert not any(array.flags.writeable for array in arrays)


def test_shapes_and_types_are_those_of_the_sensors() -> None:
    (rgb,) = opened(EmulatedCamera(count=1))
    assert (rgb.payload.data.shape, rgb.payload.data.dtype) == ((480, 848, 3), np.uint8)
    (thermal,) = opened(EmulatedThermal(count=1))
    assert (thermal.payload.data.shape, thermal.payload.data.dtype) == ((512, 640), np.uint8)
    assert thermal.payload.camera == "thermal"
    (depth,) = opened(EmulatedDepth(count=1))
    assert (depth.payload.depth.shape, depth.payload.depth.dtype) == ((480, 848), np.uint16)
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


def test_points_lie_in_their_row_and_column_or_there_is_no_return() -> None:
    (scan,) = opened(EmulatedLidar(count=1, rows=64, columns=256))
    points = scan.payload.points.reshape(64, 256, 3).astype(np.float64)
    distance = np.linalg.norm(points, axis=-1)
    hit = distance > 0
    assert 0.5 < hit.mean() < 0.9
    assert distance.max() < 50
    elevation = np.degrees(np.arcsin(points[hit][:, 2] / distance[hit]))
    azimuth = np.degrees(np.arctan2(points[hit][:, 1], points[hit][:, 0]))
    row, column = np.nonzero(hit)
    np.testing.assert_allclose(elevation, 45 - (row + 0.5) * 90 / 64, atol=1e-3)
    np.testing.assert_allclose(azimuth, 180 - (column + 0.5) * 360 / 256, atol=1e-3)


def test_depth_is_that_of_the_camera_of_the_same_options_and_stamped_alike() -> None:
    options = {"calibration": DOWN, "camera": "belly", "jitter_ms": 3.0, "count": 20}
    color, depth = (list(opened(make(**options))) for make in (EmulatedCamera, EmulatedDepth))
    assert [message.stamp for message in color] == [message.stamp for message in depth]
    road = read_classes(color[0].payload.data) == load_taxonomy().id("road")
    assert road.all()
    assert (depth[0].payload.depth == 4000).all()  # straight down to the road
    assert depth[0].payload.unit_m == 0.001


def test_what_is_too_far_for_a_stereo_camera_has_no_depth() -> None:
    (depth,) = opened(EmulatedDepth(count=1))
    assert (depth.payload.depth[:200, 424] == 0).all()  # the sky, looking ahead
    assert 15_000 < depth.payload.depth.max() < 20_000


def test_a_sensor_stands_where_the_calibration_has_it_and_must_be_in_it() -> None:
    (scan,) = opened(EmulatedLidar(calibration=DOWN, count=1))
    assert scan.payload.points[:, 2].min() == pytest.approx(-5.0)  # 1 m above the base
    with pytest.raises(DataError, match=r"no calibration for sensor 'bely' \(known: belly, lidar"):
        EmulatedCamera(calibration=DOWN, camera="bely")
    with pytest.raises(DataError, match=r"no calibration for sensor 'os1'"):
        EmulatedLidar(calibration=DOWN, sensor="os1")


def test_the_vehicle_moves_at_its_speed() -> None:
    poses = list(opened(EmulatedOdometry(count=101, speed_m_s=2, rate_hz=100)))
    assert poses[-1].payload.map_from_base[0, 3] == pytest.approx(2.0)


def test_no_message_at_all_is_a_bad_option() -> None:
    with pytest.raises(ValueError, match="count must be at least 1"):
        EmulatedCamera(count=0)
