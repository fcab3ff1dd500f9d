"""Labeled scans as a sequence in SemanticKITTI's layout, which tools for LiDAR segmentation read.

velodyne/NNNNNN.bin (x y z remission), labels/NNNNNN.label, poses.txt, calib.txt (the LiDAR is the
base, so Tr is the identity) and times.txt; and sequence.yaml, which says what the layout cannot:
the rows and columns of an organized scan, and whose ids the labels are.
"""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import yaml
from numpy.typing import NDArray

from stages.observed import Observation
from stages.sinks.labels import ids_of
from stages.sinks.whole_file import whole_file

SIDECAR = "sequence.yaml"
#: A camera that is none, for readers that want one.
IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0"


class SequenceWriter:
    """Writes scans as frames 0, 1, 2 ... of a sequence; a context manager."""

    def __init__(self, folder: Path, label_set: str | None, *, scans: bool = True) -> None:
        """`label_set` of the taxonomy whose ids to write, None for our own; `scans` False writes
        the labels alone. Raises ValueError for an unknown set."""
        self._folder = folder
        self._label_set = label_set
        self._ids = ids_of(label_set)
        self._scans = scans
        self._poses: list[str] = []
        self._times: list[str] = []
        self._shape: tuple[int, int] | None = None
        self._sensor = ""

    def __enter__(self) -> Self:
        for name, ending in (("velodyne", "bin"), ("labels", "label")):
            for old in (self._folder / name).glob(f"*.{ending}"):
                old.unlink()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is not None:
            return
        side = {
            "labels": self._label_set or "overflight",
            "shape": list(self._shape) if self._shape else None,
            "sensor": self._sensor,
        }
        texts = {
            "poses.txt": "\n".join(self._poses) + "\n",
            "times.txt": "\n".join(self._times) + "\n",
            "calib.txt": f"P2: {IDENTITY}\nTr: {IDENTITY}\n",
            SIDECAR: yaml.safe_dump(side, sort_keys=False),
        }
        for name, text in texts.items():
            with whole_file(self._folder / name) as file:
                file.write(text.encode())

    def write(self, observation: Observation, labels: NDArray[np.uint8]) -> None:
        """The next frame: the labels (n,) of its points, ids of the taxonomy."""
        number = len(self._poses)
        with whole_file(self._folder / "labels" / f"{number:06d}.label") as file:
            file.write(self._ids[labels].astype("<u4").tobytes())
        if self._scans:
            rows = np.zeros((len(observation.points), 4), dtype="<f4")
            rows[:, :3] = observation.points
            if observation.remission is not None:
                rows[:, 3] = observation.remission
            with whole_file(self._folder / "velodyne" / f"{number:06d}.bin") as file:
                file.write(rows.tobytes())
        pose = np.eye(4) if observation.map_from_sensor is None else observation.map_from_sensor
        self._poses.append(" ".join(f"{value:.9g}" for value in pose[:3].ravel()))
        self._times.append(f"{observation.stamp / 1e9:.9f}")
        self._shape, self._sensor = observation.shape, observation.sensor
