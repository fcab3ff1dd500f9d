"""Ouster recordings: the reader's own work on made-up frames, then the SDK and real recordings."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.errors import DataError
from pipeline.message import Message
from stages.kernels.range_image import organized_cells, project_scan
from stages.sources import ouster
from stages.sources.ouster import OusterPoses, OusterScans, calibration, destaggered, first_columns
from stages.types import Pose, Scan

ROWS, COLUMNS = 4, 64
PACKETS = 4
#: Degrees by which each row's beam looks to the side, as on a real sensor, and up.
SIDEWAYS = np.array([11.24, 3.93, -3.29, -10.34])
UP = np.array([30.0, 10.0, -10.0, -30.0])
START, PERIOD, COLUMN = 5_000_000_000, 100_000_000, 1_500_000
HOST = 1_700_000_000_000_000_000  #: host minus sensor clock


def azimuths() -> np.ndarray:
    """(ROWS, COLUMNS) where each measurement looks, in the order of firing."""
    turn = np.pi - 2 * np.pi * (np.arange(COLUMNS) + 0.4) / COLUMNS
    return turn - np.radians(SIDEWAYS)[:, None]


def project(ranges_mm: Any) -> np.ndarray:
    """What the SDK does with a frame or with plain ranges."""
    mm = ranges_mm.field("RANGE") if isinstance(ranges_mm, Frame) else ranges_mm
    up, turn = np.radians(UP)[:, None], azimuths()
    x, y = np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn)
    directions = np.stack([x, y, np.broadcast_to(np.sin(up), x.shape)], axis=-1)
    return (directions * mm[..., None] / 1000).astype(np.float32)


class Frame:
    """What is read of a frame of the SDK; `delays_ns` are those of its packets, if it knows."""

    def __init__(
        self,
        number: int = 0,
        delays_ns: tuple[int, ...] = (300, 200, 250, 400),
        lost: slice = slice(0, 0),
        fields: tuple[str, ...] = ("RANGE", "REFLECTIVITY"),
        body_to_world: np.ndarray | None = None,
    ) -> None:
        self.fields = fields
        still = np.tile(np.eye(4), (COLUMNS, 1, 1))
        self.body_to_world = still if body_to_world is None else body_to_world
        self.status = np.full(COLUMNS, 5, np.uint32)  # other bits may be set as well
        self.status[lost] = 4
        stamps = START + number * PERIOD + np.arange(COLUMNS) * COLUMN
        stamps[lost] = 0
        last = stamps.reshape(PACKETS, -1).max(axis=1)
        arrivals = np.where(last > 0, last + HOST + delays_ns, 0) if delays_ns else last * 0
        self.timestamp = stamps.astype(np.uint64)
        self.packet_timestamp = arrivals.astype(np.uint64)

    def has_field(self, name: str) -> bool:
        return name in self.fields

    def field(self, name: str) -> np.ndarray:
        if name == "RANGE":
            ranges = np.full((ROWS, COLUMNS), 9_000, np.uint32)
            ranges[:, 5] = 0
            return ranges
        return (np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS) % 256).astype(np.uint16)


class Recording(list[list[Frame | None]]):
    """What the SDK opens."""

    sensor_info = (
        SimpleNamespace(
            h=ROWS,
            w=COLUMNS,
            format=SimpleNamespace(column_window=(0, COLUMNS - 1)),
            sensor_to_body=np.diag([1.0, -1.0, -1.0, 1.0]),
        ),
    )

    def single(self, sensor: int) -> Recording:
        return self


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Makes the reader find these frames in any file."""

    def record(*frames: Frame | None) -> Path:
        recording = Recording([[frame] for frame in frames])
        monkeypatch.setattr(ouster, "_open", lambda path, metadata: recording)
        monkeypatch.setattr(ouster, "_projection", lambda info: project)
        return Path("street.pcap")

    return record


def read(source: OusterScans | OusterPoses) -> list[Any]:
    source.open()
    return list(source.messages())


def scans(path: Path, **options: Any) -> list[Message[Scan]]:
    return read(OusterScans(path=path, **options))


def test_a_scan_is_upright_with_the_time_of_every_point(recorded: Any) -> None:
    (message,) = scans(recorded(Frame()))
    scan = message.payload
    assert scan.shape == (ROWS, COLUMNS)
    assert scan.sensor == "lidar"
    assert scan.times_ns is not None
    assert scan.remission is not None
    _, cell, distance = project_scan(scan.points, (ROWS, COLUMNS), (-np.pi / 4, np.pi / 4))
    returned = distance > 0
    assert returned.sum() == ROWS * (COLUMNS - 1)
    own = np.arange(ROWS * COLUMNS)
    np.testing.assert_array_equal(cell[returned] % COLUMNS, own[returned] % COLUMNS)
    # The beam of a row fired what is in this column when the head had turned that much less.
    azimuth = np.arctan2(scan.points[:, 1], scan.points[:, 0])[returned]
    sideways = np.radians(SIDEWAYS)[own[returned] // COLUMNS]
    fired = (np.pi - azimuth - sideways) / (2 * np.pi) * COLUMNS - 0.4
    fired = np.rint(fired).astype(int) % COLUMNS
    stamps = message.stamp + scan.times_ns[returned].astype(np.int64)
    np.testing.assert_array_equal(stamps, START + fired * COLUMN)
    raw = (own[returned] // COLUMNS * COLUMNS + fired) % 256
    np.testing.assert_allclose(scan.remission[returned] * 255, raw, atol=1e-4)


def test_a_scan_is_stamped_in_the_middle_of_its_sweep_on_the_sensor_s_clock(recorded: Any) -> None:
    first, second = scans(recorded(Frame(), None, Frame(1)))
    assert first.begin == START
    assert first.end == START + (COLUMNS - 1) * COLUMN
    assert first.stamp == (first.begin + first.end) // 2
    assert second.stamp - first.stamp == PERIOD
    assert first.received == first.end + 400 - 200  # the packet that waited least counts as at once


def test_on_the_host_s_clock_the_least_delay_of_the_last_frames_is_taken_off(recorded: Any) -> None:
    late = (900, 950, 990, 901)
    frames = [Frame(0), *(Frame(k, late) for k in range(1, 12))]
    found = scans(recorded(*frames), clock="host")
    by_sensor = scans(recorded(*frames))
    shifts = [a.stamp - b.stamp for a, b in zip(found, by_sensor, strict=True)]
    assert shifts == [HOST + 200] * 10 + [HOST + 900] * 2
    for message, frame in zip(found, frames, strict=True):
        assert message.received == int(frame.packet_timestamp.max())
        assert message.begin <= message.stamp <= message.end <= message.received


def test_without_arrival_times_a_scan_arrives_at_its_end_and_has_no_host_clock(
    recorded: Any,
) -> None:
    path = recorded(Frame(delays_ns=()))
    (message,) = scans(path)
    assert message.received == message.end
    with pytest.raises(DataError, match="use clock: sensor"):
        scans(path, clock="host")


def test_lost_columns_have_no_return_and_are_counted(recorded: Any) -> None:
    source = OusterScans(path=recorded(Frame(lost=slice(0, 20))))
    (message,) = read(source)
    scan = message.payload
    assert message.begin == START + 20 * COLUMN
    assert message.stamp == (message.begin + message.end) // 2
    assert np.count_nonzero(scan.points.any(axis=1)) == ROWS * (COLUMNS - 20)
    assert abs(scan.times_ns).max() <= message.end - message.stamp + 1
    assert source.statistics() == {"frames_without_columns": 0, "columns_missing": 20}


def test_a_frame_without_columns_is_left_out_and_counted(recorded: Any) -> None:
    source = OusterScans(path=recorded(Frame(lost=slice(None)), Frame(1)))
    (message,) = read(source)
    assert message.begin == START + PERIOD
    assert source.statistics()["frames_without_columns"] == 1


def test_a_recording_without_frames_or_without_this_sensor_is_said(recorded: Any) -> None:
    path = recorded()
    with pytest.raises(DataError, match="no frame of sensor 0 in it; is it cut off"):
        scans(path)
    with pytest.raises(DataError, match="has 1 sensor, counted from 0; there is no sensor 2"):
        scans(path, sensor=2)


def test_what_breaks_off_in_the_middle_is_said(recorded: Any, monkeypatch: Any) -> None:
    class Broken(Recording):
        def __iter__(self) -> Iterator[Any]:
            yield [Frame()]
            raise RuntimeError("bad chunk")

    path = recorded()
    monkeypatch.setattr(ouster, "_open", lambda path, metadata: Broken())
    with pytest.raises(DataError, match=r"street.pcap: cannot be read further \(bad chunk\)"):
        scans(path)


def test_without_signal_reflectivity_is_the_remission_and_that_is_said_once(
    recorded: Any, caplog: pytest.LogCaptureFixture
) -> None:
    found = scans(recorded(Frame(), Frame(1)), remission="signal")
    given = scans(recorded(Frame()))
    np.testing.assert_array_equal(found[0].payload.remission, given[0].payload.remission)
    assert [record.getMessage() for record in caplog.records] == [
        "street.pcap: the recording has no SIGNAL; the remission is REFLECTIVITY"
    ]


def test_signal_is_the_remission_on_request_and_missing_where_nothing_is(
    recorded: Any, caplog: pytest.LogCaptureFixture
) -> None:
    both = ("RANGE", "REFLECTIVITY", "SIGNAL")
    (message,) = scans(recorded(Frame(fields=both)), remission="signal")
    assert message.payload.remission is not None
    assert message.payload.remission.max() == pytest.approx(255 / 65_535)
    assert not caplog.records
    (message,) = scans(recorded(Frame(fields=("RANGE",))))
    assert message.payload.remission is None
    assert "no REFLECTIVITY; the remission is missing" in caplog.text


def test_poses_of_a_file_hold_in_the_middle_of_each_sweep(recorded: Any, tmp_path: Path) -> None:
    file = tmp_path / "poses.txt"
    file.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 2 + "1 0 0 2.5 0 1 0 0 0 0 1 0\n")
    path = recorded(Frame(), Frame(1, lost=slice(None)), Frame(2))
    found = read(OusterPoses(path=path, poses=file))
    assert [message.stamp for message in found] == [m.stamp for m in scans(path)]
    assert found[1].payload.map_from_base[0, 3] == 2.5  # the third: frames count, not scans
    path = recorded(*(Frame(k) for k in range(4)))
    with pytest.raises(DataError, match="holds 3 poses; the scans are more"):
        read(OusterPoses(path=path, poses=file))


def test_poses_that_the_recording_holds_hold_at_their_columns(
    recorded: Any, caplog: pytest.LogCaptureFixture
) -> None:
    moving = np.tile(np.eye(4), (2, COLUMNS, 1, 1))
    moving[..., 0, 3] = np.arange(2 * COLUMNS).reshape(2, COLUMNS)
    frames = [Frame(k, body_to_world=moving[k]) for k in range(2)]
    found: list[Message[Pose]] = read(OusterPoses(path=recorded(*frames)))
    assert len(found) == 16
    stamps = np.array([message.stamp for message in found])
    assert (np.diff(stamps) > 0).all()
    for message in found:
        column = int(message.payload.map_from_base[0, 3])
        frame, column = divmod(column, COLUMNS)
        assert message.stamp == START + frame * PERIOD + column * COLUMN
    assert [found[0].stamp, found[7].stamp] == [START, START + (COLUMNS - 1) * COLUMN]
    assert not caplog.records


def test_without_poses_the_vehicle_stands_still_and_that_is_said(
    recorded: Any, caplog: pytest.LogCaptureFixture
) -> None:
    found = read(OusterPoses(path=recorded(*(Frame(k) for k in range(3)))))
    assert all((message.payload.map_from_base == np.eye(4)).all() for message in found)
    assert len(caplog.records) == 1
    assert "holds no poses; the vehicle is taken as standing still" in caplog.text


def test_the_calibration_says_where_each_sensor_sits(recorded: Any) -> None:
    found = calibration(path=recorded())
    assert list(found.sensors) == ["lidar"]
    np.testing.assert_array_equal(found.sensor("lidar").base_from_sensor[1], [0, -1, 0, 0])


def test_every_measurement_is_in_one_pixel() -> None:
    rng = np.random.default_rng(0)
    for columns in (512, 1024, 2048):
        first = rng.integers(0, columns, 32)
        order = destaggered(first, columns)
        assert len(np.unique(order)) == 32 * columns
        assert (order[np.arange(32) * columns + first] == np.arange(32) * columns).all()
    behind = np.array([[-1, 1e-6, 0], [0, 1, 0], [1, 0, 0], [0, -1, 0]], np.float32)
    assert first_columns(behind, 1024).tolist() == [0, 256, 512, 768]


def test_what_is_no_recording_is_said(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="sensor counts from 0, not -1"):
        OusterScans(path=tmp_path, sensor=-1)
    for path in (tmp_path, tmp_path / "absent.pcap", tmp_path / "os-122.local"):
        with pytest.raises(DataError, match=r"no recording of an Ouster LiDAR \(.pcap, .osf"):
            calibration(path=path)


def test_without_the_sdk_the_error_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ouster", None)
    monkeypatch.setitem(sys.modules, "ouster.sdk", None)
    (tmp_path / "a.pcap").touch()
    with pytest.raises(DataError, match=r"pip install 'overflight\[ouster\]'"):
        calibration(path=tmp_path / "a.pcap")


@pytest.fixture
def street(shared: Path) -> Path:
    """The folder of real recordings, where the SDK can read them."""
    pytest.importorskip("ouster.sdk", reason="needs the Ouster SDK: the extra 'ouster'")
    return shared / "data" / "ouster"


OS0, OS1 = "OS-0-128-U1_v2.3.0_1024x10.pcap", "OS-1-128_v2.3.0_1024x10_lb_n3"


def test_a_real_scan_lies_where_eq_18_puts_it(street: Path) -> None:
    (message,) = scans(street / OS0)
    points = message.payload.points
    _, cell, distance = project_scan(points, (64, 512), (-np.pi / 4, np.pi / 4))
    assert (distance > 0).mean() == pytest.approx(0.742, abs=0.001)
    assert np.median(distance[distance > 0]) == pytest.approx(7.5, abs=0.1)
    _, own = organized_cells((128, 1024), (64, 512))
    far = (distance > 4) & (cell >= 0)
    off = abs((cell[far] - own[far] + 256) % 512 - 256)
    assert off.max() <= 1
    assert message.end - message.begin == pytest.approx(99.9e6, abs=1e5)


def test_a_recording_gives_the_same_scans_from_pcap_and_osf(street: Path) -> None:
    pairs = zip(scans(street / f"{OS1}.pcap"), scans(street / f"{OS1}.osf"), strict=True)
    for number, (packets, frames) in enumerate(pairs):
        np.testing.assert_array_equal(packets.payload.points, frames.payload.points)
        np.testing.assert_array_equal(packets.payload.times_ns, frames.payload.times_ns)
        assert packets.stamp == frames.stamp
        assert packets.received > packets.end
        assert number < 3


def test_a_recording_cut_off_ends_with_a_partial_scan(street: Path, tmp_path: Path) -> None:
    content = (street / f"{OS1}.pcap").read_bytes()
    (tmp_path / "cut.pcap").write_bytes(content[: len(content) // 2])
    shutil.copy(street / "OS-1-128_v2.3.0_1024x10.json", tmp_path / "cut.json")
    source = OusterScans(path=tmp_path / "cut.pcap")
    whole, part = read(source)
    assert source.statistics()["columns_missing"] == 528
    assert np.isfinite(part.payload.points).all()
    share = np.count_nonzero(part.payload.points.any(axis=1)) / np.count_nonzero(
        whole.payload.points.any(axis=1)
    )
    assert 0.3 < share < 0.7
    (tmp_path / "lone.pcap").write_bytes(content)
    with pytest.raises(DataError, match="matching metadata"):
        scans(tmp_path / "lone.pcap")
    (found, *_) = scans(tmp_path / "lone.pcap", metadata=tmp_path / "cut.json")
    np.testing.assert_array_equal(found.payload.points, whole.payload.points)


def test_an_osf_knows_where_its_sensor_sits(street: Path) -> None:
    found = calibration(path=street / "osf_fw_3.2_10scans.osf").sensor("lidar")
    np.testing.assert_allclose(found.base_from_sensor[:3, 3], [-2.39, 0.51, 1.08], atol=0.01)
