"""Drives of the KITTI family as three sources and a calibration.

Layouts: the decimated and the full excerpt of a KITTI raw drive, KITTI odometry / SemanticKITTI
folders, and single RELLIS-3D frames (see `kitti_layouts`). The sets carry no stamps: frame k is
stamped k / `rate_hz`, the same in all three sources, and may be restamped with an offset, a jitter
and an arrival delay to stand for sensors that are not triggered together.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import ClassVar

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.stage import Source, Timing
from stages.sources.kitti_layouts import CAMERA, LIDAR, Drive, open_drive
from stages.sources.pictures import read_picture
from stages.sources.stamps import Stamps
from stages.types import Calibration, Image, Pose, Scan


def calibration(*, path: Path) -> Calibration:
    """The calibration of a drive: `camera` and `lidar`; the LiDAR is the base. Raises DataError."""
    return open_drive(path).read_calibration()


class _Kitti(Source):
    """What the three have in common. `start` and `stop` count frames; `stop` itself is left out."""

    what: ClassVar[str]

    def __init__(
        self,
        *,
        path: Path,
        rate_hz: float = 10.0,
        offset_ms: float = 0.0,
        jitter_ms: float = 0.0,
        delay_ms: float = 0.0,
        seed: int = 0,
        start: int = 0,
        stop: int | None = None,
    ) -> None:
        if start < 0 or (stop is not None and stop <= start):
            raise ValueError(f"start {start} and stop {stop} leave no frame")
        self.path = path
        self.start = start
        self.stop = stop
        self._stamps = Stamps(rate_hz, offset_ms, jitter_ms, delay_ms, seed)

    def timing(self) -> Timing:
        return self._stamps.timing()

    def open(self) -> None:
        self._drive: Drive = open_drive(self.path)

    def last_arrival(self) -> int:
        return self._stamps.last_arrival(self._asked_for())

    def _frames(self) -> Iterator[tuple[int, int]]:
        """(frame, stamp) of the frames asked for."""
        return self._stamps.of(self._asked_for())

    def _asked_for(self) -> list[int]:
        frames = [
            frame
            for frame in sorted(self._present())
            if frame >= self.start and (self.stop is None or frame < self.stop)
        ]
        if not frames:
            raise DataError(f"{self.path}: has no {self.what} in the frames asked for")
        return frames

    def _present(self) -> Iterable[int]:
        """The frames that the drive has."""
        raise NotImplementedError


class KittiImages(_Kitti):
    """The camera's images."""

    what = "images"

    def _present(self) -> Iterable[int]:
        return self._drive.images

    def messages(self) -> Iterator[Message[Image]]:
        files = self._drive.images
        for frame, stamp in self._frames():
            image = Image(read_picture(files[frame]), CAMERA)
            yield Message.at(stamp, image, received=self._stamps.arrival(stamp))


class KittiScans(_Kitti):
    """The LiDAR's scans, as snapshots: the points carry no times of their own."""

    what = "scans"

    def _present(self) -> Iterable[int]:
        return self._drive.scans

    def messages(self) -> Iterator[Message[Scan]]:
        files = self._drive.scans
        for frame, stamp in self._frames():
            points, remission = self._drive.read_scan(files[frame])
            scan = Scan(points, remission, times_ns=None, shape=None, sensor=LIDAR)
            yield Message.at(stamp, scan, received=self._stamps.arrival(stamp))


class KittiPoses(_Kitti):
    """The odometry's poses of the LiDAR, one per scan."""

    what = "poses"

    def open(self) -> None:
        super().open()
        self._poses = self._drive.read_poses()

    def _present(self) -> Iterable[int]:
        return range(len(self._poses))

    def messages(self) -> Iterator[Message[Pose]]:
        for frame, stamp in self._frames():
            yield Message.at(stamp, Pose(self._poses[frame]), received=self._stamps.arrival(stamp))
