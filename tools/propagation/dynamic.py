"""What moves has no place in a map of a whole flight: two ways to label it by what is near in time.

`RecentHits` is the temporal limit: a voxel's moving class holds for a scan only if some point of
that class hit it in a scan near in time. `DynamicWindow` lets moving classes be said by the scans
near in time alone, and everything else by the whole map.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stages.kernels.horizon import MAX_WINDOW
from stages.kernels.propagation import confident_labels
from stages.observed import Observation, Said, read_observation
from stages.voxel_map import VoxelMap
from tools.propagation.map_index import MapIndex


class RecentHits:
    """How many of the scans within `reach` of this one hit each voxel with the voxel's class."""

    def __init__(self, index: MapIndex, dynamic: NDArray[np.bool_], reach: int) -> None:
        self._index = index
        self._moving = dynamic[index.labels]
        self._counts = np.zeros(len(index.labels), dtype=np.int32)
        self._reach = reach
        self._window: deque[NDArray[np.int32]] = deque()

    def enter(self, observation: Observation | None, said: Said | None) -> None:
        """The scan `reach` after the one that is labeled next comes into the window, or none."""
        slots = np.zeros(0, dtype=np.int32)
        if observation is not None and said is not None:
            slots = self._hit(observation, said)
        self._window.append(slots)
        self._counts[slots] += 1
        if len(self._window) > 2 * self._reach + 1:
            self._counts[self._window.popleft()] -= 1

    def keeps(self, slots: NDArray[np.int32]) -> NDArray[np.bool_]:
        """(n,) which slots (n,) hold their label now: all that do not move, and what was hit."""
        if len(self._counts) == 0:
            return np.ones(len(slots), dtype=np.bool_)
        return (slots < 0) | ~self._moving[slots] | (self._counts[slots] > 0)

    def _hit(self, observation: Observation, said: Said) -> NDArray[np.int32]:
        if observation.map_from_sensor is None or len(said.index) == 0:
            return np.zeros(0, dtype=np.int32)
        points = observation.points[said.index]
        wanted = np.ones(len(points), dtype=np.bool_)
        slots = self._index.slots(points, wanted, observation.map_from_sensor)
        own = said.rows().argmax(axis=1).astype(np.uint8)
        agrees = (slots >= 0) & (self._index.at(slots) == own)
        agrees &= self._moving[np.maximum(slots, 0)]
        return np.unique(slots[agrees])


class DynamicWindow:
    """A map of the scans within `reach` of this one, of which only the moving classes are read."""

    def __init__(
        self,
        voxel_m: float,
        classes: int,
        dynamic: NDArray[np.bool_],
        confidence: float,
        reach: int,
    ) -> None:
        """Raises ValueError for a reach that no window can hold."""
        scans = 2 * reach + 1
        if not 1 <= scans <= MAX_WINDOW:
            raise ValueError(f"a window of {reach} scans: 0 to {(MAX_WINDOW - 1) // 2} can be kept")
        self._dynamic = dynamic
        self._classes = classes
        self._confidence = confidence
        self._map = VoxelMap(voxel_m=voxel_m, classes=classes, horizon="window-drop", scans=scans)

    def enter(self, observation: Observation | None, said: Said | None) -> None:
        """As for `RecentHits`."""
        pose, stamp = np.eye(4), 0
        if observation is None or said is None or observation.map_from_sensor is None:
            nothing = np.zeros((0, 16), dtype=np.float16)
            observation = Observation(
                0, np.zeros((0, 3), np.float32), None, None, "", pose,
                Said(np.zeros(0, np.int32), nothing), None, False,
            )  # fmt: skip
            said = observation.camera
        else:
            pose, stamp = observation.map_from_sensor, observation.stamp
        self._map.integrate(observation.cloud(said), pose, stamp)

    def labels(self, observation: Observation, wanted: NDArray[np.bool_]) -> NDArray[np.uint8]:
        """(n,) the moving class that the window has where a point lies; 0 where none."""
        if observation.map_from_sensor is None:
            return np.zeros(len(observation.points), dtype=np.uint8)
        voxels = self._map.snapshot(recent=True)
        labels = confident_labels(voxels.log_scores, self._classes, self._confidence)
        moving = self._dynamic[labels]
        chosen = replace(
            voxels,
            indices=voxels.indices[moving],
            positions=voxels.positions[moving],
            log_scores=voxels.log_scores[moving],
            counts=voxels.counts[moving],
        )
        index = MapIndex.of(chosen, self._classes, self._confidence, labels=labels[moving])
        return index.at(index.slots(observation.points, wanted, observation.map_from_sensor))


def with_ahead(
    files: Sequence[Path], reach: int
) -> Iterator[tuple[Observation | None, Observation | None]]:
    """(the scan to label, the scan `reach` after it that comes into a window); the first pairs have
    no scan to label, the last no scan that comes in."""
    held: deque[Observation] = deque()
    for file in files:
        ahead = read_observation(file)
        held.append(ahead)
        yield (held.popleft() if len(held) > reach else None), ahead
    for one in held:
        yield one, None
