"""A simulated flight: every sensor's samples, each with its exact ground truth.

A sample depends on the preset, the seed and its own time alone, so that samples can be made in any
order and on any number of threads (the kernels release the GIL) and are the same.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.message import Message
from stages.kernels.geometry import rotation_exp
from stages.labels import LabeledVoxels, Labels
from stages.simulation.camera import render
from stages.simulation.district import District, build_district
from stages.simulation.hits import Hits
from stages.simulation.lidar import sweep
from stages.simulation.specification import (
    POSE,
    LidarSpec,
    Preset,
    RgbdSpec,
    Sensor,
    ThermalSpec,
    load_rig,
)
from stages.simulation.stereo import stereo_depth
from stages.simulation.thermal import thermal_image
from stages.simulation.trace import Packet
from stages.simulation.true_map import voxel_truth
from stages.simulation.truth import visible_boxes
from stages.types import DepthImage, Image, Pose, Scan

_MS = 1_000_000
#: Extinction per meter times the visibility: where a black target has 2 % of its contrast left.
KOSCHMIEDER = 3.912
#: Moving things are put in their places so often during a sweep: a car at 9 m/s is then at most
#: 6 cm from where it was at a column's time.
_SCENES_PER_SWEEP = 8
#: Points lie on a grid of 4 mm, far below their noise: it halves the size of a recording.
_STEP_M = np.float32(1 / 256)


@dataclass(frozen=True, slots=True)
class Exposure:
    """One sensor's turn to sample."""

    sensor: str
    frame: int
    time_ns: int  #: true time; mid-sweep for a LiDAR
    received_ns: int


@dataclass(frozen=True, slots=True)
class Sample:
    """A message on its topic."""

    topic: str
    message: Message[Any]


class Simulation:
    """A flight of a preset. Building it takes some seconds; raises DataError for wrong files."""

    def __init__(self, preset: Preset, folder: Path) -> None:
        self.preset = preset
        self.rig = load_rig(preset, folder)
        self.district: District = build_district(
            *(preset.seed, preset.duration_s, preset.speed_m_s, preset.height_m),
            *(self.rig.body, preset.site),
        )

    def exposures(self) -> Sequence[Exposure]:
        """All samples to be made, in the order in which they arrive."""
        turns = []
        for name, rate_hz in self.preset.rates_hz.items():
            sensor = self.rig.sensors.get(name)
            phase_ns = round(sensor.mount.phase_ms * _MS) if sensor else 0
            delay_ns = round(sensor.mount.delay_ms * _MS) if sensor else 0
            extent_ns = 0
            if sensor and isinstance(sensor.spec, LidarSpec):
                extent_ns = round(0.5e9 / rate_hz)
            for frame in range(1 + int(self.preset.duration_s * rate_hz)):
                time_ns = phase_ns + extent_ns + round(frame * 1e9 / rate_hz)
                if time_ns + extent_ns <= self.preset.duration_s * 1e9:
                    received = time_ns + extent_ns + delay_ns
                    turns.append(Exposure(name, frame, time_ns, received))
        return sorted(turns, key=lambda turn: (turn.received_ns, turn.sensor))

    def take(self, turn: Exposure) -> Iterator[Sample]:
        """The samples of one turn, and what is true of them under ``truth/``."""
        if turn.sensor == POSE:
            yield from self._poses(turn)
            return
        sensor = self.rig.sensors[turn.sensor]
        if isinstance(sensor.spec, RgbdSpec):
            yield from self._rgbd(sensor, sensor.spec, turn)
        elif isinstance(sensor.spec, ThermalSpec):
            yield from self._thermal(sensor, sensor.spec, turn)
        else:
            yield from self._scan(sensor, sensor.spec, turn)

    def voxels(self) -> LabeledVoxels:
        """The true map of what stands still around the flight."""
        step = max(1, len(self.district.flight.stamps) // 400)
        track = self.district.flight.map_from_base[::step, :3, 3]
        return voxel_truth(self.district.still, self.district.classes, track)

    def _poses(self, turn: Exposure) -> Iterator[Sample]:
        pose = self.district.flight.at(np.array([turn.time_ns]))[0]
        yield Sample("truth/pose", Message.at(turn.time_ns, Pose(_locked(pose))))
        random = np.random.default_rng([self.preset.seed, 0x905E, turn.frame])
        noisy = pose.copy()
        noisy[:3, 3] += random.normal(0, self.preset.pose_noise_m, 3)
        turned = rotation_exp(random.normal(0, np.radians(self.preset.pose_noise_deg), 3))
        noisy[:3, :3] = noisy[:3, :3] @ turned
        message = Message.at(turn.time_ns, Pose(_locked(noisy)), received=turn.received_ns)
        yield Sample(POSE, message)

    def _rgbd(self, sensor: Sensor, spec: RgbdSpec, turn: Exposure) -> Iterator[Sample]:
        camera = sensor.calibration.camera
        assert camera is not None
        width, height = camera.size
        color = np.empty((height, width, 3), dtype=np.uint8)
        depth = np.empty((height, width), dtype=np.float32)
        things = np.empty((height, width), dtype=np.uint16)
        salt = self._salt(turn)
        district = self.district
        pose = self._camera_pose(sensor, turn.time_ns)
        packets = (Packet.new(), Packet.new(), Hits.new())
        intrinsics = camera.intrinsics()
        render(
            *(district.at(turn.time_ns), *packets, pose, intrinsics, district.sun),
            *(salt, spec.noise, self._dust, color, depth, things),
        )
        stereo = spec.depth
        counts = np.empty((height, width), dtype=np.uint16)
        # A smaller image has larger pixels: noise and steps are those of the full resolution.
        scale = camera.fx / spec.camera.fx
        stereo_depth(
            depth,
            camera.fx,
            stereo.baseline_m,
            stereo.noise_px * scale,
            stereo.step_px * scale,
            stereo.min_m,
            stereo.max_m,
            stereo.unit_m,
            salt,
            counts,
        )
        name = sensor.name
        yield self._sample(name, turn, Image(_locked(color), name))
        yield self._sample(f"{name}/depth", turn, DepthImage(_locked(counts), stereo.unit_m, name))
        yield from self._truth(name, turn, things)

    def _thermal(self, sensor: Sensor, spec: ThermalSpec, turn: Exposure) -> Iterator[Sample]:
        camera = sensor.calibration.camera
        assert camera is not None
        district = self.district
        pose = self._camera_pose(sensor, turn.time_ns)
        scene = district.at(turn.time_ns)
        intrinsics = camera.intrinsics()
        counts, things = thermal_image(
            *(scene, pose, intrinsics, camera.size, district.sun),
            *(self.preset.seed, turn.frame, spec.netd_k, self._dust),
        )
        yield self._sample(sensor.name, turn, Image(_locked(counts), sensor.name))
        yield from self._truth(sensor.name, turn, things)

    def _scan(self, sensor: Sensor, spec: LidarSpec, turn: Exposure) -> Iterator[Sample]:
        scale = self.preset.scale
        azimuths, elevations = spec.azimuths(scale), spec.elevations(scale)
        columns, rows = len(azimuths), len(elevations)
        half_ns = round(0.5e9 / self.preset.rates_hz[sensor.name])
        middle = (np.arange(columns) + 0.5) / columns * 2 - 1
        times_ns = np.round(middle * half_ns).astype(np.int64)
        poses = self.district.flight.at(turn.time_ns + times_ns)
        world_from_column = (poses @ sensor.calibration.base_from_sensor)[:, :3]
        ranges = np.empty((rows, columns), dtype=np.float32)
        reflectivity = np.empty((rows, columns), dtype=np.float32)
        things = np.empty((rows, columns), dtype=np.uint16)
        packet, hits = Packet.new(), Hits.new()
        edges = np.linspace(0, columns, _SCENES_PER_SWEEP + 1).astype(int)
        for first, last in pairwise(edges.tolist()):
            scene = self.district.at(turn.time_ns + int(times_ns[(first + last) // 2]))
            sweep(
                *(scene, packet, hits, first, last, world_from_column.astype(np.float32)),
                *(azimuths, elevations, spec.min_m, spec.max_m, spec.full_m, spec.noise_m),
                *(self._dust, self._salt(turn), ranges, reflectivity, things),
            )
        scan = Scan(
            points=_locked(_unprojected(ranges, azimuths, elevations)),
            remission=_locked(
                np.round(reflectivity.reshape(-1) * np.float32(255)) / np.float32(255)
            ),
            times_ns=_locked(np.tile(times_ns.astype(np.int32), rows)),
            shape=(rows, columns),
            sensor=sensor.name,
        )
        yield self._sample(sensor.name, turn, scan, half_ns)
        labels = Labels(self._classes(things, nothing=0), _locked(things), sensor.name)
        yield self._sample(f"truth/{sensor.name}", turn, labels, half_ns)

    def _truth(self, name: str, turn: Exposure, things: NDArray[np.uint16]) -> Iterator[Sample]:
        """Labels and boxes of an image."""
        labels = Labels(self._classes(things), _locked(things), name)
        yield self._sample(f"truth/{name}", turn, labels)
        yield self._sample(f"truth/{name}/boxes", turn, visible_boxes(labels))

    def _classes(self, things: NDArray[np.uint16], nothing: int | None = None) -> NDArray[np.uint8]:
        table = self.district.classes
        if nothing is not None:
            table = table.copy()
            table[0] = nothing
        return _locked(table[things])

    def _sample(self, topic: str, turn: Exposure, payload: Any, half_ns: int = 0) -> Sample:
        """A sample stamped by its sensor's clock."""
        mount = self.rig.sensors[turn.sensor].mount
        stamp = turn.time_ns + round(mount.clock_offset_ms * _MS)
        begin, end = stamp - half_ns, stamp + half_ns
        received = max(turn.received_ns, end)
        return Sample(topic, Message.at(stamp, payload, begin=begin, end=end, received=received))

    def _camera_pose(self, sensor: Sensor, time_ns: int) -> NDArray[np.float32]:
        map_from_base = self.district.flight.at(np.array([time_ns]))[0]
        pose = map_from_base @ sensor.calibration.base_from_sensor
        return np.ascontiguousarray(pose[:3], dtype=np.float32)

    @property
    def _dust(self) -> float:
        """Extinction of the air, per m."""
        seen_m = self.preset.visibility_m
        return 0.0 if seen_m is None else KOSCHMIEDER / seen_m

    def _salt(self, turn: Exposure) -> int:
        """What makes the noise of every sample its own."""
        return zlib.crc32(f"{self.preset.seed} {turn.sensor} {turn.frame}".encode()) >> 4


def _unprojected(
    ranges: NDArray[np.float32],
    azimuths: NDArray[np.float64],
    elevations: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Points (n, 3), row by row, of ranges (rows, columns); the origin where there is none."""
    level = np.cos(elevations)[:, None]
    x, y = level * np.cos(azimuths), level * np.sin(azimuths)
    z = np.broadcast_to(np.sin(elevations)[:, None], ranges.shape)
    rays = np.stack([x, y, z], axis=-1).astype(np.float32)
    points = (rays * ranges[..., None]).reshape(-1, 3)
    return np.asarray(np.round(points / _STEP_M) * _STEP_M, dtype=np.float32)


def _locked(array: NDArray[Any]) -> NDArray[Any]:
    array.flags.writeable = False
    return array
