"""Emulated sensors: the shapes, rates, jitter and delays of real ones, on a street that is made up.

A payload is made once, when the source opens, and fits the motion all the same (see
`stages.emulated_street`), so a message costs next to nothing and the load in a profile is the
graph's own. Without `count` a stream has no end. The vehicle flies along x.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import count as counted_from

import numpy as np

from pipeline.message import Message
from pipeline.stage import Source, Timing
from stages.emulated_street import (
    lidar_rays,
    look_along,
    look_through,
    painted,
    painted_gray,
)
from stages.kernels.compiled import locked
from stages.sources.stamps import Stamps
from stages.types import Calibration, Camera, DepthImage, Image, Pose, Scan

NOWHERE = Calibration()

#: A camera looking ahead, x right, y down, z forward.
AHEAD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])

DEPTH_UNIT_M = 0.001
DEPTH_REACH_M = 20.0  #: of a stereo camera
LIDAR_REACH_M = 50.0


class _Emulated(Source):
    """The timing that all of them share: frame k is stamped `phase_ms` + k / `rate_hz`, with a
    uniform jitter, and arrives `delay_ms` after its stamp, or once its capture is over."""

    def __init__(
        self,
        *,
        rate_hz: float,
        jitter_ms: float,
        delay_ms: float,
        phase_ms: float,
        count: int | None,
        seed: int,
    ) -> None:
        if count is not None and count < 1:
            raise ValueError(f"count must be at least 1, not {count}")
        self.count = count
        self.seed = seed
        self._stamps = Stamps(rate_hz, phase_ms, jitter_ms, delay_ms, seed)

    def timing(self) -> Timing:
        return self._stamps.timing()

    def last_arrival(self) -> int | None:
        return self._stamps.last_arrival(range(self.count)) if self.count else None

    def _frames(self) -> Iterator[tuple[int, int]]:
        return self._stamps.of(counted_from() if self.count is None else range(self.count))


class _EmulatedCamera(_Emulated):
    """A camera where the calibration has it; without any calibration one of `width` x `height`
    that looks ahead through a 90 deg lens."""

    def __init__(
        self,
        *,
        calibration: Calibration = NOWHERE,
        camera: str = "rgb",
        width: int = 848,
        height: int = 480,
        rate_hz: float = 30.0,
        jitter_ms: float = 0.0,
        delay_ms: float = 0.0,
        phase_ms: float = 0.0,
        count: int | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(
            rate_hz=rate_hz,
            jitter_ms=jitter_ms,
            delay_ms=delay_ms,
            phase_ms=phase_ms,
            count=count,
            seed=seed,
        )
        self.camera = camera
        if calibration.sensors:
            self._lens = calibration.camera(camera)
            self._pose = calibration.sensor(camera).base_from_sensor
        else:
            center = (width - 1) / 2, (height - 1) / 2
            self._lens = Camera((width, height), width / 2, width / 2, *center)
            self._pose = AHEAD


class EmulatedCamera(_EmulatedCamera):
    """An RGB camera: (height, width, 3) uint8, everything in the color of its class."""

    def open(self) -> None:
        sight = look_through(self._lens, self._pose)
        self._image = Image(locked(painted(sight.label)), self.camera)

    def messages(self) -> Iterator[Message[Image]]:
        for _, stamp in self._frames():
            yield Message.at(stamp, self._image, received=self._stamps.arrival(stamp))


class EmulatedDepth(_EmulatedCamera):
    """The depth of an RGB-D camera, (height, width) uint16 mm, aligned to its color and stamped
    alike: an `EmulatedCamera` with the same options, `seed` too, gives the same stamps."""

    def open(self) -> None:
        depth = look_through(self._lens, self._pose).distance
        counts = np.where(depth < DEPTH_REACH_M, np.rint(depth / DEPTH_UNIT_M), 0)
        self._image = DepthImage(locked(counts.astype(np.uint16)), DEPTH_UNIT_M, self.camera)

    def messages(self) -> Iterator[Message[DepthImage]]:
        for _, stamp in self._frames():
            yield Message.at(stamp, self._image, received=self._stamps.arrival(stamp))


class EmulatedThermal(_EmulatedCamera):
    """A thermal camera with its gain control on: (height, width) uint8, what is warm is bright."""

    def __init__(
        self,
        *,
        calibration: Calibration = NOWHERE,
        camera: str = "thermal",
        width: int = 640,
        height: int = 512,
        rate_hz: float = 30.0,
        jitter_ms: float = 0.0,
        delay_ms: float = 0.0,
        phase_ms: float = 0.0,
        count: int | None = None,
        seed: int = 1,
    ) -> None:
        super().__init__(
            calibration=calibration,
            camera=camera,
            width=width,
            height=height,
            rate_hz=rate_hz,
            jitter_ms=jitter_ms,
            delay_ms=delay_ms,
            phase_ms=phase_ms,
            count=count,
            seed=seed,
        )

    def open(self) -> None:
        sight = look_through(self._lens, self._pose)
        self._image = Image(locked(painted_gray(sight.label)), self.camera)

    def messages(self) -> Iterator[Message[Image]]:
        for _, stamp in self._frames():
            yield Message.at(stamp, self._image, received=self._stamps.arrival(stamp))


class EmulatedLidar(_Emulated):
    """A spinning LiDAR of `rows` beams over +-45 deg that sees 50 m far: organized scans.

    A scan is stamped mid-sweep; `begin` and `end` are half a period before and after it, and column
    times run evenly over the sweep.
    """

    def __init__(
        self,
        *,
        calibration: Calibration = NOWHERE,
        sensor: str = "lidar",
        rows: int = 128,
        columns: int = 1024,
        rate_hz: float = 10.0,
        jitter_ms: float = 0.0,
        delay_ms: float = 50.0,
        phase_ms: float = 0.0,
        count: int | None = None,
        seed: int = 2,
    ) -> None:
        super().__init__(
            rate_hz=rate_hz,
            jitter_ms=jitter_ms,
            delay_ms=delay_ms,
            phase_ms=phase_ms,
            count=count,
            seed=seed,
        )
        self.sensor = sensor
        self.shape = (rows, columns)
        known = calibration.sensors
        self._pose = calibration.sensor(sensor).base_from_sensor if known else np.eye(4)
        self._half_sweep = round(0.5e9 / rate_hz)

    def open(self) -> None:
        rows, columns = self.shape
        rays = lidar_rays(rows, columns)
        sight = look_along(rays, self._pose)
        distance = np.where(sight.distance < LIDAR_REACH_M, sight.distance, np.float32(0))
        columns_ns = np.linspace(-self._half_sweep, self._half_sweep, columns, dtype=np.int32)
        self._scan = Scan(
            points=locked((distance[..., None] * rays).reshape(-1, 3)),
            remission=locked(painted_gray(sight.label).reshape(-1) * np.float32(1 / 255)),
            times_ns=locked(np.tile(columns_ns, rows)),
            shape=self.shape,
            sensor=self.sensor,
        )

    def timing(self) -> Timing:
        return replace(self._stamps.timing(), extent_ms=self._half_sweep / 1e6)

    def messages(self) -> Iterator[Message[Scan]]:
        for _, stamp in self._frames():
            begin, end = stamp - self._half_sweep, stamp + self._half_sweep
            received = self._stamps.arrival(stamp, end)
            yield Message.at(stamp, self._scan, begin=begin, end=end, received=received)


class EmulatedOdometry(_Emulated):
    """Poses of a level straight flight along x at `speed_m_s`."""

    def __init__(
        self,
        *,
        speed_m_s: float = 2.0,
        rate_hz: float = 100.0,
        jitter_ms: float = 0.0,
        delay_ms: float = 0.0,
        phase_ms: float = 0.0,
        count: int | None = None,
        seed: int = 3,
    ) -> None:
        super().__init__(
            rate_hz=rate_hz,
            jitter_ms=jitter_ms,
            delay_ms=delay_ms,
            phase_ms=phase_ms,
            count=count,
            seed=seed,
        )
        self.speed_m_s = speed_m_s

    def messages(self) -> Iterator[Message[Pose]]:
        origin = np.eye(4)
        for _, stamp in self._frames():
            map_from_base = origin.copy()
            map_from_base[0, 3] = self.speed_m_s * stamp / 1e9
            map_from_base.flags.writeable = False
            yield Message.at(stamp, Pose(map_from_base), received=self._stamps.arrival(stamp))
