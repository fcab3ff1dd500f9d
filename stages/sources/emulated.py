"""Emulated sensors: the shapes, rates, jitter and delays of real ones, and nothing to see.

A payload is made once, when the source opens, so a message costs next to nothing and the load in a
profile is the graph's own. Without `count` a stream has no end.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count as counted_from

import numpy as np

from pipeline.message import Message
from pipeline.stage import Source, Timing
from stages.sources.stamps import Stamps
from stages.types import Image, Pose, Scan


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

    def _frames(self) -> Iterator[tuple[int, int]]:
        return self._stamps.of(counted_from() if self.count is None else range(self.count))


class EmulatedCamera(_Emulated):
    """An RGB camera: (height, width, 3) uint8 noise."""

    def __init__(
        self,
        *,
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
        self.shape: tuple[int, ...] = (height, width, 3)

    def open(self) -> None:
        noise = np.random.default_rng(self.seed).integers(0, 256, self.shape, dtype=np.uint8)
        noise.flags.writeable = False
        self._image = Image(noise, self.camera)

    def messages(self) -> Iterator[Message[Image]]:
        for _, stamp in self._frames():
            yield Message.at(stamp, self._image, received=self._stamps.arrival(stamp))


class EmulatedThermal(EmulatedCamera):
    """A thermal camera with its gain control on: (height, width) uint8 noise."""

    def __init__(
        self,
        *,
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
        self.shape = (height, width)


class EmulatedLidar(_Emulated):
    """A spinning LiDAR of `rows` beams over +-45 deg: organised scans of a sphere of 10 m.

    A scan is stamped mid-sweep; `begin` and `end` are half a period before and after it, and column
    times run evenly over the sweep.
    """

    def __init__(
        self,
        *,
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
        self._half_sweep = round(0.5e9 / rate_hz)

    def open(self) -> None:
        rows, columns = self.shape
        elevation = np.linspace(np.pi / 4, -np.pi / 4, rows)[:, None]
        azimuth = np.linspace(np.pi, -np.pi, columns, endpoint=False)[None, :]
        x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
        points = 10.0 * np.stack(np.broadcast_arrays(x, y, np.sin(elevation)), axis=-1)
        columns_ns = np.linspace(-self._half_sweep, self._half_sweep, columns, dtype=np.int32)
        self._scan = Scan(
            points=points.reshape(-1, 3).astype(np.float32),
            remission=np.random.default_rng(self.seed).random(rows * columns, dtype=np.float32),
            times_ns=np.tile(columns_ns, rows),
            shape=self.shape,
            sensor=self.sensor,
        )
        for array in (self._scan.points, self._scan.remission, self._scan.times_ns):
            if array is not None:
                array.flags.writeable = False

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
        for _, stamp in self._frames():
            map_from_base = np.eye(4)
            map_from_base[0, 3] = self.speed_m_s * stamp / 1e9
            map_from_base.flags.writeable = False
            yield Message.at(stamp, Pose(map_from_base), received=self._stamps.arrival(stamp))
