"""Where a sensor is at an instant, and what a camera sees of a cloud (eq 1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import as_input
from stages.kernels.geometry import interpolate_poses, invert
from stages.kernels.projection import fold_limit, hidden, project
from stages.types import Calibration, Camera, Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Points in a camera's image."""

    index: NDArray[np.int64]  #: (m,) rows of the cloud
    pixel: NDArray[np.float32]  #: (m, 2) u v
    distance: NDArray[np.float32]  #: (m,) from the camera, m


def map_from_sensor(
    calibration: Calibration, sensor: str, stamp: int, path: Trajectory
) -> NDArray[np.float64] | None:
    """A sensor's pose in the map (4, 4) at `stamp`; None where no pose covers it."""
    poses, covered = interpolate_poses(path.stamps, path.map_from_base, np.array([stamp]))
    if not covered[0]:
        return None
    return np.asarray(poses[0] @ calibration.sensor(sensor).base_from_sensor)


def mounted(calibration: Calibration, camera: str, sensor: str) -> NDArray[np.float64]:
    """camera_from_sensor (4, 4) on the vehicle, both at the same instant."""
    base_from_camera = calibration.sensor(camera).base_from_sensor
    return np.asarray(invert(base_from_camera) @ calibration.sensor(sensor).base_from_sensor)


def look(
    camera: Camera,
    points: NDArray[np.float32],
    usable: NDArray[np.bool_],
    camera_from_sensor: NDArray[np.float64],
) -> View:
    """What lies in a camera's image of the usable points (n, 3), hidden or not."""
    intrinsics = camera.intrinsics()
    limit = fold_limit(intrinsics)
    seen = project(
        as_input(points), as_input(usable), camera_from_sensor, intrinsics, *camera.size, limit
    )
    return View(*seen)


def without_hidden(view: View, camera: Camera, reach_deg: float) -> View:
    """The points of a view that no nearer one hides, found within `reach_deg` of each."""
    reach_px = round(camera.fx * math.tan(math.radians(reach_deg)))
    seen = ~hidden(view.pixel, view.distance, camera.size, reach_px)
    return View(view.index[seen], view.pixel[seen], view.distance[seen])
