"""An aggregated cloud as a source of scans: an OS0 above the vehicle that gathered it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stages.kernels.views import seen_in_window, view
from stages.taxonomy import load_taxonomy
from tools.train.scan_sources import LabeledPoints

#: Rows and columns of the simulated sensor, and its field of view.
SIZE, ELEVATION_RAD = (128, 1024), (-np.pi / 4, np.pi / 4)
#: The paper says "raised"; a UAV of its flights is so high.
HEIGHTS_M = (5.0, 15.0)
MAX_RANGE_M = 50.0
#: Scans to each side whose moving points are seen: the paper's choice of 0, 2 and 5.
WINDOW = 2
#: Between points of a cloud, m: nearer surfaces would be seen through.
POINT_M = 0.10


@dataclass(frozen=True, slots=True, eq=False)
class AggregatedCloud:
    """Points of many scans in one frame, z up."""

    points: NDArray[np.float32]  #: (n, 3) m
    remission: NDArray[np.float32]  #: (n,) 0..1
    classes: NDArray[np.uint8]  #: (n,) ids of the taxonomy
    scans: NDArray[np.int32]  #: (n,) number of the scan that took it
    path: NDArray[np.float64]  #: (scans, 3) where the sensor was


@dataclass(frozen=True, slots=True)
class SimulatedViews:
    """Scans from viewpoints over the path, each a height of its own: a source of training scans."""

    told: str
    cloud: AggregatedCloud
    every: int = 1  #: scans of the vehicle between two views
    window: int = WINDOW
    size: tuple[int, int] = SIZE
    heights_m: tuple[float, float] = field(default=HEIGHTS_M)

    def __len__(self) -> int:
        return len(range(0, len(self.cloud.path), self.every))

    def read(self, number: int) -> LabeledPoints:
        """The view over scan `number * every`; the same number, the same height."""
        at_scan = number * self.every
        height = np.random.default_rng(number).uniform(*self.heights_m)
        return scan_from(
            self.cloud,
            self.cloud.path[at_scan] + [0, 0, height],
            at_scan,
            window=self.window,
            size=self.size,
        )


def scan_from(
    cloud: AggregatedCloud,
    viewpoint_m: NDArray[np.float64],
    at_scan: int,
    *,
    window: int = WINDOW,
    size: tuple[int, int] = SIZE,
) -> LabeledPoints:
    """The organized scan that the simulated sensor takes at a viewpoint (3,) at that time."""
    there = np.flatnonzero(
        seen_in_window(cloud.classes, cloud.scans, load_taxonomy().dynamic, at_scan, window)
    )
    nearest, local = view(
        cloud.points[there],
        viewpoint_m,
        size,
        ELEVATION_RAD,
        max_range_m=MAX_RANGE_M,
        point_m=POINT_M,
    )
    cell = nearest.ravel()
    hit = cell >= 0
    points = np.zeros((len(cell), 3), dtype=np.float32)
    points[hit] = local[cell[hit]]
    remission = np.zeros(len(cell), dtype=np.float32)
    remission[hit] = cloud.remission[there[cell[hit]]]
    classes = np.zeros(len(cell), dtype=np.uint8)
    classes[hit] = cloud.classes[there[cell[hit]]]
    return LabeledPoints(points, remission, classes, size)
