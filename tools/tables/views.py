"""Views over a simulated street, as of Paris-CARLA-3D: a driven LiDAR's cloud, from above."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from stages.frames import map_from_sensor
from stages.labels import Labels
from stages.observed import Observation, Said
from stages.sources.recording import calibration
from stages.types import Scan, Trajectory
from tools.propagation.sequence import SequenceWriter
from tools.train.aggregated import AggregatedCloud, SimulatedViews
from tools.train.flights import messages_of

LIDAR, POSE = "lidar", "pose"
#: Points of a scan that are kept: a street is seen by many scans.
EVERY_POINT = 2
#: Above the car's sensor: so that they look from where the flights of the tables are.
HEIGHTS_M = (3.0, 9.0)


def cloud_of_flight(flight: Path) -> AggregatedCloud:
    """All scans of a simulated drive with their true classes in one frame. Raises DataError."""
    sensors = calibration(path=flight)
    path = Trajectory.of(tuple(messages_of(flight, POSE)))
    truths = {one.stamp: one.payload for one in messages_of(flight, f"truth/{LIDAR}")}
    points, remissions, classes, scans = [], [], [], []
    where: list[NDArray[np.float64]] = []
    for message in messages_of(flight, LIDAR):
        scan, truth = message.payload, truths.get(message.stamp)
        pose = map_from_sensor(sensors, LIDAR, message.stamp, path)
        if pose is None or not isinstance(truth, Labels) or not isinstance(scan, Scan):
            continue
        hit = np.flatnonzero(scan.points.any(axis=1))[::EVERY_POINT]
        points.append((scan.points[hit] @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32))
        nothing = np.zeros(len(scan.points), dtype=np.float32)
        remissions.append((nothing if scan.remission is None else scan.remission)[hit])
        classes.append(truth.classes.ravel()[hit])
        scans.append(np.full(len(hit), len(where), dtype=np.int32))
        where.append(pose[:3, 3])
    if not where:
        raise DataError(f"{flight}: has no scans with poses and truth")
    return AggregatedCloud(
        np.concatenate(points),
        np.concatenate(remissions),
        np.concatenate(classes),
        np.concatenate(scans),
        np.array(where),
    )


def write_views(flight: Path, folder: Path) -> None:
    """The views over a drive as a sequence of labeled scans."""
    views = SimulatedViews(flight.name, cloud_of_flight(flight), heights_m=HEIGHTS_M)
    nothing = Said(np.zeros(0, np.int32), np.zeros((0, 16), np.float16))
    with SequenceWriter(folder, None) as writer:
        for number in range(len(views)):
            one = views.read(number)
            observation = Observation(
                number, one.points, one.remission, one.shape, LIDAR, None, nothing, None, False
            )
            writer.write(observation, one.classes)
