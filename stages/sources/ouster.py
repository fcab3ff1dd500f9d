"""Recordings of Ouster LiDARs (.pcap with its .json, .osf, .bag) as scans, poses and a calibration.

Needs the Ouster SDK: ``pip install 'overflight[ouster]'``. Of two returns the first is taken, which
is the stronger unless the sensor was told otherwise.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.stage import Source
from stages.kernels.range_image import as_remission
from stages.sources.kitti_files import read_poses
from stages.types import Calibration, Pose, Scan, SensorCalibration

log = logging.getLogger(__name__)

SUFFIXES = (".pcap", ".osf", ".bag")

#: Frames over which the least arrival delay counts as none: long enough to meet a packet that
#: nothing held up, short enough that two clocks 50 ppm apart part by no more than 50 us.
CLOCK_WINDOW = 10

#: Poses that a sweep gives where the recording holds one per column: every 7 to 14 ms.
POSES_PER_SWEEP = 8

#: What counts as 1. REFLECTIVITY is 0..255; SIGNAL (photons) is taken at the full range of its
#: counter, so that nothing saturates: the network's statistics undo the scale.
FULL_SCALE = {"REFLECTIVITY": 255.0, "SIGNAL": 65_535.0}


def calibration(*, path: Path, metadata: Path | None = None) -> Calibration:
    """Where the recording's sensors sit: `lidar`, then `lidar1`, ... Raises DataError."""
    infos = _open(path, metadata).sensor_info
    return Calibration(
        {_name(k): SensorCalibration(np.array(info.sensor_to_body)) for k, info in enumerate(infos)}
    )


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """A frame of the SDK and its times, ns on the graph's clock."""

    frame: Any
    number: int  #: of the frame in the recording
    measured: NDArray[np.bool_]  #: (columns,) False: lost, or outside the azimuth window
    times: NDArray[np.int64]  #: (columns,), 0 where not measured
    begin: int
    end: int
    received: int

    @property
    def stamp(self) -> int:
        """The middle of what was measured."""
        return (self.begin + self.end) // 2


class _Ouster(Source):
    """What scans and poses have in common: the sweeps of one sensor, on one clock."""

    def __init__(
        self,
        *,
        path: Path,
        metadata: Path | None = None,
        sensor: int = 0,
        clock: Literal["sensor", "host"] = "sensor",
    ) -> None:
        if sensor < 0:
            raise ValueError(f"sensor counts from 0, not {sensor}")
        self.path = path
        self.metadata = metadata
        self.sensor = sensor
        self.clock = clock
        self._empty = self._missing = 0

    def open(self) -> None:
        recording = _open(self.path, self.metadata)
        sensors = len(recording.sensor_info)
        if self.sensor >= sensors:
            raise DataError(
                f"{self.path}: has {sensors} sensor{'s' * (sensors != 1)}, counted from 0; "
                f"there is no sensor {self.sensor}"
            )
        self._recording = recording.single(self.sensor)
        self._info = recording.sensor_info[self.sensor]

    def statistics(self) -> Mapping[str, float]:
        """Frames left out since no column of them arrived, and columns missing in the others."""
        return {"frames_without_columns": self._empty, "columns_missing": self._missing}

    def _sweeps(self) -> Iterator[Sweep]:
        delays: deque[int] = deque(maxlen=CLOCK_WINDOW)
        lowest, highest = self._info.format.column_window
        window = (highest - lowest) % self._info.w + 1
        number = -1
        for number, frame in enumerate(self._frames()):
            measured = np.asarray(frame.status & 1, dtype=np.bool_)
            if not measured.any():
                self._empty += 1
                continue
            self._missing += max(0, window - int(measured.sum()))
            yield self._sweep(frame, number, measured, delays)
        if number < 0:
            raise DataError(
                f"{self.path}: no frame of sensor {self.sensor} in it; is it cut off, or the "
                "metadata that of another recording?"
            )

    def _frames(self) -> Iterator[Any]:
        try:
            for frames in self._recording:
                yield from (frame for frame in frames if frame is not None)
        except (RuntimeError, ValueError, OSError) as error:  # the SDK's, in words of its own
            raise DataError(f"{self.path}: cannot be read further ({error})") from error

    def _sweep(
        self, frame: Any, number: int, measured: NDArray[np.bool_], delays: deque[int]
    ) -> Sweep:
        times = np.where(measured, frame.timestamp.astype(np.int64), 0)
        arrivals = frame.packet_timestamp.astype(np.int64)
        last_of_packet = times.reshape(len(arrivals), -1).max(axis=1)
        arrived = (arrivals > 0) & (last_of_packet > 0)
        begin, end = int(times[measured].min()), int(times[measured].max())
        received = end
        if arrived.any():
            # Host minus sensor clock, as the packet that waited least tells it.
            delays.append(int((arrivals - last_of_packet)[arrived].min()))
            received = max(end, int(arrivals[arrived].max()) - min(delays))
        if self.clock == "sensor":
            return Sweep(frame, number, measured, times, begin, end, received)
        if not delays:
            raise DataError(
                f"{self.path}: does not hold when its packets arrived; use clock: sensor"
            )
        shift = min(delays)
        times = np.where(measured, times + shift, 0)
        return Sweep(frame, number, measured, times, begin + shift, end + shift, received + shift)


class OusterScans(_Ouster):
    """Organized scans with the time of every point; what has no return or was lost is zeros.

    Column 0 looks straight behind, as in eq 18. A scan is stamped in the middle of what was
    measured, on the sensor's own clock (since boot, or that of PTP), or with ``clock: host`` on
    that of the computer that recorded the packets. `statistics` counts what was lost.
    """

    def __init__(
        self,
        *,
        path: Path,
        metadata: Path | None = None,
        sensor: int = 0,
        clock: Literal["sensor", "host"] = "sensor",
        remission: Literal["reflectivity", "signal"] = "reflectivity",
    ) -> None:
        """`metadata` is the .json of a .pcap, by default the one beside it. `sensor` says which of
        several, from 0. `clock` is the one that stamps: the sensor's or that of the recording host.
        `remission` of the scan: low-bandwidth profiles have no signal; then the reflectivity is
        taken, and said so.
        """
        super().__init__(path=path, metadata=metadata, sensor=sensor, clock=clock)
        self.remission = remission
        self._announced = False

    def messages(self) -> Iterator[Message[Scan]]:
        to_points = _projection(self._info)
        size = (self._info.h, self._info.w)
        ahead = to_points(np.full(size, 1_000_000, dtype=np.uint32))[:, 0]
        order = destaggered(first_columns(ahead, size[1]), size[1])
        column = order % size[1]
        for sweep in self._sweeps():
            points = np.take(to_points(sweep.frame).reshape(-1, 3), order, axis=0)
            if not sweep.measured.all():
                points[~sweep.measured[column]] = 0.0
            remission = self._remission(sweep.frame)
            if remission is not None:
                remission = remission[order]
            times = np.where(sweep.measured, sweep.times - sweep.stamp, 0).astype(np.int32)
            scan = Scan(points, remission, times[column], size, _name(self.sensor))
            yield Message.at(
                sweep.stamp, scan, begin=sweep.begin, end=sweep.end, received=sweep.received
            )

    def _remission(self, frame: Any) -> NDArray[np.float32] | None:
        """(n,) as measured, row by row; where another field than asked for has to do, once said."""
        wanted = self.remission.upper()
        found = next((name for name in (wanted, "REFLECTIVITY") if frame.has_field(name)), None)
        if found != wanted and not self._announced:
            self._announced = True
            log.warning(
                "%s: the recording has no %s; the remission is %s",
                self.path,
                wanted,
                found or "missing",
            )
        return as_remission(frame.field(found).reshape(-1), FULL_SCALE[found]) if found else None


class OusterPoses(_Ouster):
    """The vehicle's poses, of a file or of the recording; without either it stands still.

    A file holds one for the middle of each sweep, in KITTI's format; a recording (an .osf that the
    SDK's SLAM wrote) one per column, of which some are given. Standing still is announced.
    """

    def __init__(
        self,
        *,
        path: Path,
        metadata: Path | None = None,
        sensor: int = 0,
        clock: Literal["sensor", "host"] = "sensor",
        poses: Path | None = None,
    ) -> None:
        """`metadata`, `sensor` and `clock` as those of the scans. `poses` is the file of poses, one
        per frame of the recording.
        """
        super().__init__(path=path, metadata=metadata, sensor=sensor, clock=clock)
        self.poses = poses

    def messages(self) -> Iterator[Message[Pose]]:
        given = None if self.poses is None else read_poses(self.poses)
        still = given is None
        for sweep in self._sweeps():
            if given is None:
                columns = np.flatnonzero(sweep.measured)
                spread = np.linspace(0, len(columns) - 1, POSES_PER_SWEEP).astype(np.int64)
                chosen = columns[np.unique(spread)]
                stamps, matrices = sweep.times[chosen], np.array(sweep.frame.body_to_world[chosen])
            elif sweep.number < len(given):
                stamps, matrices = np.array([sweep.stamp]), given[sweep.number, None]
            else:
                raise DataError(f"{self.poses}: holds {len(given)} poses; the scans are more")
            still &= bool((matrices == np.eye(4)).all())
            if still and sweep.number == 1:
                log.warning(
                    "%s: the recording holds no poses; the vehicle is taken as standing still",
                    self.path,
                )
            for stamp, matrix in zip(stamps, matrices, strict=True):
                yield Message.at(int(stamp), Pose(matrix), received=sweep.received)


def first_columns(points: NDArray[np.float32], columns: int) -> NDArray[np.int64]:
    """The column of eq 18 (rows,) that each row's first measurement belongs in.

    `points` (rows, 3) are far points that the rows see in it. Beams are fired side by side, up to
    12 degrees apart, and the metadata's own pixel shifts leave an old firmware's image turned by as
    much: so the shifts come from where the beams look.
    """
    azimuth = np.arctan2(points[:, 1].astype(np.float64), points[:, 0])
    return np.floor((np.pi - azimuth) / (2 * np.pi) * columns).astype(np.int64) % columns


def destaggered(first: NDArray[np.int64], columns: int) -> NDArray[np.int64]:
    """For each pixel of the upright image, row by row, the number of the measurement in it
    (rows * columns,); `first` (rows,) as `first_columns` gives it."""
    rows = np.arange(len(first))[:, None]
    measured = (np.arange(columns) - first[:, None]) % columns
    return (rows * columns + measured).reshape(-1)


def _name(sensor: int) -> str:
    return f"lidar{sensor}" if sensor else "lidar"


def _open(path: Path, metadata: Path | None) -> Any:
    """The SDK's source of the frames of all sensors. Raises DataError."""
    if path.suffix.lower() not in SUFFIXES or not path.is_file():
        # Anything else the SDK would take for a picture, or for a sensor in the network.
        raise DataError(f"{path}: no recording of an Ouster LiDAR ({', '.join(SUFFIXES)})")
    try:
        from ouster.sdk import SourceURLException, open_source
    except ImportError as error:
        raise DataError(
            f"{path}: reading it needs the Ouster SDK: pip install 'overflight[ouster]' ({error})"
        ) from error
    options: dict[str, Any] = {} if metadata is None else {"meta": [str(metadata)]}
    try:
        return open_source(str(path), collate=False, **options)
    except SourceURLException as error:
        raise DataError(f"{path}: {error.get_sub_exception()}") from error


def _projection(info: Any) -> Any:
    """The SDK's function from a frame, or its ranges in mm, to points (rows, columns, 3), m."""
    from ouster.sdk.core import XYZLutFloat

    return XYZLutFloat(info, False)  # False: in the sensor's frame, not the body's
