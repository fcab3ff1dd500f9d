"""Observations: a scan as it came, where it was taken, and what was said of its points, as a file.

Between the networks and the label propagation: the networks run once, and maps, thresholds and
windows are tried on their observations afterward.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from stages.kernels.probability import PADDING
from stages.sinks.whole_file import whole_file
from stages.types import CHANNELS, Cloud


@dataclass(frozen=True, slots=True, eq=False)
class Said:
    """Class evidence of some points of a scan."""

    index: NDArray[np.int32]  #: (k,) the points, rising
    log_scores: NDArray[np.float16]  #: (k, CHANNELS) up to a constant per point

    @classmethod
    def of(cls, cloud: Cloud) -> Said:
        """What a cloud says. Half precision halves the file: 0.03 nat at the map's floor of -60."""
        index = np.flatnonzero(cloud.evidence).astype(np.int32)
        rows = cloud.log_scores[index]
        rows = np.maximum(rows - rows.max(axis=1, keepdims=True, initial=-60.0), -6e4)
        return cls(index, rows.astype(np.float16))

    def rows(self) -> NDArray[np.float32]:
        """(k, CHANNELS) float32, with padding as the kernels want it."""
        rows = self.log_scores.astype(np.float32)
        rows[self.log_scores < -1e3] = PADDING
        return rows


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """One scan with everything that label propagation wants of it."""

    stamp: int  #: ns
    points: NDArray[np.float32]  #: (n, 3) m in the sensor's frame at the stamp; 0: no return
    remission: NDArray[np.float32] | None  #: (n,) 0..1
    shape: tuple[int, int] | None  #: (rows, columns) of an organized scan
    sensor: str
    map_from_sensor: NDArray[np.float64] | None  #: (4, 4)
    camera: Said  #: by cameras alone
    fused: Said | None  #: the LiDAR network's scores in it, where the graph has one
    degraded: bool  #: made on a lower rung of a ladder

    def cloud(self, said: Said) -> Cloud:
        """The points that something was said of, as the map takes them."""
        rows = said.rows()
        evidence = np.ones(len(rows), dtype=np.bool_)
        pose = self.map_from_sensor
        return Cloud(self.points[said.index], rows, evidence, pose, self.sensor)


def write_observation(path: Path, observation: Observation) -> None:
    """Write the file, whole or not at all. Raises DataError."""
    one = observation
    content: dict[str, Any] = {
        "stamp": one.stamp,
        "points": one.points,
        "sensor": one.sensor,
        "degraded": one.degraded,
        "shape": np.array(one.shape or (), dtype=np.int64),
        "camera_index": one.camera.index,
        "camera_scores": one.camera.log_scores,
    }
    if one.remission is not None:
        content["remission"] = one.remission
    if one.map_from_sensor is not None:
        content["map_from_sensor"] = one.map_from_sensor
    if one.fused is not None:
        content["fused_index"] = one.fused.index
        content["fused_scores"] = one.fused.log_scores
    with whole_file(path) as file:
        np.savez(file, **content)


def read_observation(path: Path) -> Observation:
    """The observation in a file. Raises DataError for anything else."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            held = {name: stored[name] for name in stored.files}
        shape = tuple(int(side) for side in held["shape"])
        points = held["points"]
        camera = _said(held, "camera", len(points))
        return Observation(
            stamp=int(held["stamp"]),
            points=points,
            remission=held.get("remission"),
            shape=(shape[0], shape[1]) if shape else None,
            sensor=str(held["sensor"]),
            map_from_sensor=held.get("map_from_sensor"),
            camera=camera,
            fused=_said(held, "fused", len(points)) if "fused_index" in held else None,
            degraded=bool(held["degraded"]),
        )
    except (OSError, ValueError, KeyError, IndexError, EOFError, BadZipFile) as error:
        raise DataError(
            f"{path}: is no observation ({error}); observe the recording again"
        ) from None


def _said(held: dict[str, Any], name: str, points: int) -> Said:
    said = Said(held[f"{name}_index"], held[f"{name}_scores"])
    if said.log_scores.shape != (len(said.index), CHANNELS) or said.index.max(initial=-1) >= points:
        raise ValueError(f"its scores of {name} do not fit its points")
    return said
