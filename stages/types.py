"""The payloads that stages exchange: frozen values that state shape, dtype, unit and frame once.

Frames: `sensor` is the sensor's own (cameras: x right, y down, z forward; LiDARs: x forward, y
left, z up), `base` the vehicle's body, `map` the fixed frame of the odometry. ``a_from_b`` takes
points of b into a. Class scores have 16 channels (one cache line of float32): the taxonomy's
classes and padding (`PADDING_LOG` in log arrays), so that a log-sum-exp ignores the padding.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from pipeline.message import Span

CHANNELS = 16  #: width of a row of class scores
PADDING_LOG = np.float32(-1e4)  #: log score of a padding channel


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """A camera image in full resolution."""

    data: (
        NDArray[np.uint8] | NDArray[np.uint16]
    )  #: (height, width, 3) RGB uint8, or (height, width) gray
    camera: str  #: name in the calibration


@dataclass(frozen=True, slots=True, eq=False)
class DepthImage:
    """Depth aligned to the pixels of `camera`."""

    depth: NDArray[np.uint16]  #: (height, width), 0 = no depth
    unit_m: float  #: metres per count
    camera: str


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One LiDAR scan in the sensor's frame; a row of zeros or NaN is "no return"."""

    points: NDArray[np.float32]  #: (n, 3) m
    remission: NDArray[np.float32] | None  #: (n,) 0..1
    times_ns: NDArray[np.int32] | None  #: (n,) ns after the message's stamp (negative before it)
    shape: (
        tuple[int, int] | None
    )  #: (rows, columns) of an organized scan, points row by row; else None
    sensor: str  #: name in the calibration


@dataclass(frozen=True, slots=True, eq=False)
class ClassScores:
    """Logits (or log-probabilities: both are "log scores") of one image, at any stride, in one or
    more tiles.

    Tile i covers the rectangle `rects[i]`, which its cells divide evenly and which may reach beyond
    the image (`score_grid.ScoreGrid.rect`).
    """

    grid: (
        NDArray[np.float32] | NDArray[np.int8] | NDArray[np.uint8]
    )  #: (tiles, rows, columns, CHANNELS)
    rects: NDArray[np.float32]  #: (tiles, 4) x0 y0 x1 y1: pixel edges in the full-resolution image
    scale: float  #: log score = (grid - zero_point) * scale
    zero_point: int
    camera: str
    size: tuple[int, int]  #: (width, height) of the full-resolution image


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """Boxes in full-resolution pixels of `camera`."""

    boxes: NDArray[np.float32]  #: (n, 4) x0 y0 x1 y1, pixels
    classes: NDArray[np.int64]  #: (n,) ids of the taxonomy
    scores: NDArray[np.float32]  #: (n,) 0..1
    camera: str


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """The vehicle's pose."""

    map_from_base: NDArray[np.float64]  #: (4, 4)


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses by stamp, to be interpolated."""

    stamps: NDArray[np.int64]  #: (n,) ns, increasing
    map_from_base: NDArray[np.float64]  #: (n, 4, 4)

    @classmethod
    def of(cls, poses: Span[Pose]) -> Trajectory:
        """The trajectory of a span of pose messages."""
        stamps = np.array([message.stamp for message in poses], dtype=np.int64)
        matrices = np.array([message.payload.map_from_base for message in poses], dtype=np.float64)
        return cls(stamps, matrices.reshape(-1, 4, 4))


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points with class evidence, in the sensor's frame."""

    points: NDArray[np.float32]  #: (n, 3) m; no return as in `Scan`
    log_scores: NDArray[np.float32]  #: (n, CHANNELS) log scores up to a constant per point
    evidence: NDArray[np.bool_]  #: (n,) False: no source said anything of this point (unlabeled)
    map_from_sensor: (
        NDArray[np.float64] | None
    )  #: (4, 4) at the message's stamp, where poses are known
    sensor: str
    times_ns: NDArray[np.int32] | None = (
        None  #: (n,) as in `Scan`; None: all points are where they were at the stamp
    )
    shape: tuple[int, int] | None = None  #: as in `Scan`
    voted: NDArray[np.uint32] | None = (
        None  #: (n,) who gave evidence: bit 0 the LiDAR network, then each edge of scores, of boxes
    )


@dataclass(frozen=True, slots=True, eq=False)
class SemanticVoxels:
    """A snapshot of the semantic map, in the map frame; voxels in the order of their first hit."""

    voxel_m: float  #: edge length
    indices: NDArray[np.int32]  #: (n, 3) floor(position / voxel_m)
    positions: NDArray[np.float32]  #: (n, 3) mean of the points in the voxel, m
    log_scores: NDArray[np.float32]  #: (n, CHANNELS), maximum 0
    counts: NDArray[np.int32]  #: (n,) points integrated


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera with radial-tangential distortion; the integer pixel is the pixel's
    centre."""

    size: tuple[int, int]  #: (width, height), pixels
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    )  #: k1 k2 p1 p2 k3

    def intrinsics(self) -> NDArray[np.float64]:
        """(9,) fx fy cx cy k1 k2 p1 p2 k3, as the kernels take it."""
        return np.array([self.fx, self.fy, self.cx, self.cy, *self.distortion])


@dataclass(frozen=True, slots=True, eq=False)
class SensorCalibration:
    """Where a sensor sits, and its camera model if it has one."""

    base_from_sensor: NDArray[np.float64]  #: (4, 4)
    camera: Camera | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """All sensors by name. A stage gets it by annotating an `__init__` parameter ``calibration:
    Calibration``."""

    sensors: Mapping[str, SensorCalibration] = field(default_factory=dict)

    @classmethod
    def parse(cls, block: Mapping[str, Any]) -> Calibration:
        """Read the ``calibration:`` block of a graph file; raises ValueError naming the key.

        Per sensor: ``base_from_sensor``, a (4, 4) or (3, 4) nested list, or
        ``{translation: [x, y, z], quaternion: [x, y, z, w]}``, or ``{translation: ...,
        rotation_rpy_deg: [roll, pitch, yaw]}`` (m, degrees, about the fixed x, y, z axes in this
        order); a camera has ``camera: {size: [width, height], fx, fy, cx, cy,
        distortion: [k1, k2, p1, p2, k3]}`` as well.
        """
        from stages.calibration import parse_sensor

        return cls({str(name): parse_sensor(str(name), sensor) for name, sensor in block.items()})

    def sensor(self, name: str) -> SensorCalibration:
        """The named sensor; raises DataError with the known names."""
        try:
            return self.sensors[name]
        except KeyError:
            known = ", ".join(sorted(self.sensors)) or "none"
            raise DataError(f"no calibration for sensor '{name}' (known: {known})") from None

    def cameras(self) -> tuple[str, ...]:
        """The names of the sensors that have a camera model."""
        return tuple(name for name, sensor in self.sensors.items() if sensor.camera is not None)

    def camera(self, name: str) -> Camera:
        """The camera model of the named sensor; raises DataError if it has none."""
        camera = self.sensor(name).camera
        if camera is None:
            raise DataError(f"calibration of '{name}' has no camera; add camera: {{size, fx, ...}}")
        return camera
