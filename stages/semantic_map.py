"""The allocentric semantic map: sparse voxels that multiply the evidence of all scans (eq 8-17)."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from pipeline.message import Message
from pipeline.stage import Stage
from stages.map_checkpoint import MapCheckpoint
from stages.taxonomy import load_taxonomy
from stages.types import CHANNELS, Cloud, SemanticVoxels
from stages.voxel_map import Horizon, VoxelMap, WindowOf

log = logging.getLogger(__name__)

#: Clouds between two looks for voxels to forget, which goes over the whole map.
EVICT_EVERY = 50


class SemanticMap(Stage):
    """Integrates clouds into voxels of `voxel_m` and publishes snapshots of the whole map.

    A cloud without a pose is left out (counted in `statistics`); so are points without evidence.
    How long a cloud counts is the `horizon`; see `VoxelMap`.

    With a `checkpoint` the map survives its process: it is written there every `checkpoint_s` and
    at the end, and read at the start. Clouds up to the last one in it are skipped, so a replay that
    was killed and is begun again ends with the same map, byte for byte. The poses have to be in the
    same map frame as before: odometry that begins anew at 0 needs a file of its own.
    """

    def __init__(
        self,
        *,
        voxel_m: float = 0.25,
        publish_every: int = 1,
        horizon: Horizon = "infinite",
        horizon_scans: int = 10,
        window_of: WindowOf = "map",
        merge: Literal["product", "mean"] = "product",
        max_age_s: float = np.inf,
        max_distance_m: float = np.inf,
        checkpoint: Path | None = None,
        checkpoint_s: float = 30.0,
    ) -> None:
        """`horizon`, `window_of` and `merge` as in `VoxelMap`. Voxels not hit for `max_age_s` or
        further than `max_distance_m` from the sensor are forgotten, every 50 clouds.

        `publish_every` n publishes after each n-th cloud. `checkpoint`: an npz file, written at
        most every `checkpoint_s` of the clouds' time.

        A snapshot is a copy, so that a reader can take its time: 1.7 ms at 100,000 voxels, 42 ms at
        a million, 260 ms at five. The default lets a map file hold the last scan; raise it for
        large maps, whose last snapshot may then lack up to n - 1 scans.
        """
        if publish_every < 1:
            raise ValueError(f"publish_every must be at least 1, not {publish_every}")
        if not checkpoint_s > 0:
            raise ValueError(f"checkpoint_s must be above 0, not {checkpoint_s}")
        self._publish_every = publish_every
        self._max_age_s, self._max_distance_m = max_age_s, max_distance_m
        self._new_map = partial(
            VoxelMap,
            voxel_m=voxel_m,
            classes=len(load_taxonomy()),
            horizon=horizon,
            scans=horizon_scans,
            window_of=window_of,
            merge=merge,
        )
        self._map = self._new_map()
        self._clouds = self._clouds_without_pose = self._voxels_forgotten = 0
        self._checkpoint_at = None if checkpoint is None else (Path(checkpoint), checkpoint_s)
        self._checkpoint: MapCheckpoint | None = None
        self._last_stamp: int | None = None  #: of the last cloud in the map
        self._held_before: int | None = None  #: of the last cloud in the checkpoint it began with
        self._clouds_held_before = 0

    def open(self) -> None:
        # Compiles the kernels (or loads them from the cache) now, not during the first cloud.
        point, said = np.ones((1, 3), np.float32), np.zeros((1, CHANNELS), np.float32)
        for stamp in range(self._map.scans + 1):  # until one leaves the window
            cloud = Cloud(point, said, np.ones(1, np.bool_), None, "")
            self._map.integrate(cloud, np.eye(4), stamp)
        self._map.snapshot()
        self._map = self._new_map()
        if self._checkpoint_at:
            self._checkpoint = MapCheckpoint(*self._checkpoint_at)
            self._map, self._clouds, self._held_before = self._checkpoint.resume(self._map)
            self._last_stamp = self._held_before

    def close(self) -> None:
        if self._checkpoint:
            self._checkpoint.close(self._map, self._clouds, self._last_stamp)

    def statistics(self) -> Mapping[str, float]:
        """Voxels held, clouds integrated, and what was left out and why."""
        counts = {
            "voxels": self._map.used,
            "clouds": self._clouds,
            "clouds_without_pose": self._clouds_without_pose,
            "points_out_of_reach": self._map.beyond,
            "voxels_forgotten": self._voxels_forgotten,
        }
        if self._checkpoint:
            counts["clouds_held_before"] = self._clouds_held_before
            counts["checkpoints_written"] = self._checkpoint.written
            counts["checkpoints_late"] = self._checkpoint.late
            counts["checkpoints_failed"] = self._checkpoint.failed
        return counts

    def process(self, cloud: Message[Cloud]) -> SemanticVoxels | None:
        if self._held_before is not None and cloud.stamp <= self._held_before:
            if not self._clouds_held_before:
                log.warning(
                    "the checkpoint holds the clouds up to stamp %d; they are skipped",
                    self._held_before,
                )
            self._clouds_held_before += 1
            return None
        if cloud.payload.map_from_sensor is None:
            if not self._clouds_without_pose:
                log.warning(
                    "no pose of the cloud at stamp %d; such clouds are left out", cloud.stamp
                )
            self._clouds_without_pose += 1
            return None
        pose = cloud.payload.map_from_sensor
        self._map.integrate(cloud.payload, pose, cloud.stamp)
        self._clouds += 1
        if self._clouds % EVICT_EVERY == 0 and min(self._max_age_s, self._max_distance_m) < np.inf:
            self._voxels_forgotten += self._map.evict(
                cloud.stamp,
                max_age_s=self._max_age_s,
                center=pose[:3, 3],
                max_distance_m=self._max_distance_m,
            )
        self._last_stamp = cloud.stamp
        if self._checkpoint:
            self._checkpoint.offer(self._map, self._clouds, cloud.stamp)
        return None if self._clouds % self._publish_every else self._map.snapshot()
