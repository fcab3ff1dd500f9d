"""How pure labels are inside the car boxes that people drew around a drive's objects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from stages.sources.kitti_files import read_json

#: Lower points of a box are the road under the car.
ABOVE_M = 0.25


@dataclass(frozen=True, slots=True)
class BoxVerdict:
    """Points of car boxes."""

    points: int
    labeled: int
    vehicle: int

    @property
    def labeled_share(self) -> float:
        """Of the boxes' points."""
        return self.labeled / max(self.points, 1)

    @property
    def vehicle_share(self) -> float:
        """Of the labeled ones."""
        return self.vehicle / max(self.labeled, 1)


def judge_boxes(
    annotation: Path,
    frame: Callable[[int], tuple[NDArray[np.float32], NDArray[np.uint8]]],
    vehicle: int,
    title: str = "Car",
) -> BoxVerdict:
    """Over all frames of a Supervisely annotation: `frame` gives points (n, 3) and labels (n,).

    Points count from 25 cm above the lowest point under and beside the car. Raises DataError.
    """
    content = read_json(annotation)
    points = labeled = right = 0
    try:
        wanted = {one["key"] for one in content["objects"] if one["classTitle"] == title}
        boxes = [
            (int(entry["index"]), figure["geometry"])
            for entry in content["frames"]
            for figure in entry["figures"]
            if figure["objectKey"] in wanted
        ]
        for number in sorted({index for index, _ in boxes}):
            places, labels = frame(number)
            for index, geometry in boxes:
                if index == number:
                    said = labels[inside_box(places, geometry)]
                    points += len(said)
                    labeled += int(np.count_nonzero(said))
                    right += int(np.count_nonzero(said == vehicle))
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{annotation}: is no annotation of boxes ({error!r})") from None
    return BoxVerdict(points, labeled, right)


def inside_box(points: NDArray[np.float32], geometry: dict[str, Any]) -> NDArray[np.bool_]:
    """(n,) which points lie in a box and above the road."""
    center = np.array([geometry["position"][axis] for axis in "xyz"])
    size = np.array([geometry["dimensions"][axis] for axis in "xyz"])
    yaw = float(geometry["rotation"]["z"])
    x, y, z = (points - center).T
    along = np.cos(yaw) * x + np.sin(yaw) * y
    across = -np.sin(yaw) * x + np.cos(yaw) * y
    plan = (abs(along) <= size[0] / 2) & (abs(across) <= size[1] / 2)
    near = (x * x + y * y < (size[:2].max() + 1) ** 2) & (points[:, 2] < center[2])
    if not plan.any() or not near.any():
        return np.asarray(plan & (abs(z) <= size[2] / 2))
    road = np.quantile(points[near, 2], 0.1)
    return np.asarray(plan & (abs(z) <= size[2] / 2) & (points[:, 2] > road + ABOVE_M))
