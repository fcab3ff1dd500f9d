"""The allocentric semantic map: sparse voxels that multiply the evidence of all scans (eq 8-17)."""

from __future__ import annotations

import logging
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pipeline.message import Message
from pipeline.stage import Stage
from stages.kernels.compiled import as_input
from stages.kernels.voxels import integrate, rehash, unpack
from stages.taxonomy import load_taxonomy
from stages.types import CHANNELS, Cloud, SemanticVoxels

log = logging.getLogger(__name__)

INITIAL_VOXELS = 1 << 16


class SemanticMap(Stage):
    """Integrates clouds into voxels of `voxel_m` and publishes snapshots of the whole map.

    A cloud without a pose is left out (counted in `statistics`); so are points without evidence.
    Nothing is ever forgotten: the horizon is infinite.
    """

    def __init__(self, *, voxel_m: float = 0.25, publish_every: int = 1) -> None:
        """`publish_every` n publishes after each n-th cloud.

        A snapshot is a copy, so that a reader can take its time: 1.7 ms at 100,000 voxels, 42 ms at
        a million, 260 ms at five. The default lets a map file hold the last scan; raise it for
        large maps, whose last snapshot may then lack up to n - 1 scans.
        """
        if not voxel_m > 0:
            raise ValueError(f"voxel_m must be above 0, not {voxel_m}")
        if publish_every < 1:
            raise ValueError(f"publish_every must be at least 1, not {publish_every}")
        self._voxel_m = voxel_m
        self._publish_every = publish_every
        self._classes = len(load_taxonomy())
        self._used = self._clouds = self._clouds_without_pose = self._points_out_of_reach = 0

    def open(self) -> None:
        self._used = 0
        self._table = np.zeros(4 * INITIAL_VOXELS, dtype=np.int32)
        self._keys = np.empty(INITIAL_VOXELS, dtype=np.int64)
        self._scores = np.empty((INITIAL_VOXELS, CHANNELS), dtype=np.float32)
        self._means = np.empty((INITIAL_VOXELS, 3), dtype=np.float32)
        self._counts_of = np.empty(INITIAL_VOXELS, dtype=np.int32)
        nothing = np.zeros((0, 3), dtype=np.float32)
        said = np.zeros((0, CHANNELS), dtype=np.float32)
        # Compiles the kernel (or loads it from the cache) now, not during the first cloud.
        self._integrate(Cloud(nothing, said, np.zeros(0, np.bool_), None, ""), as_input(np.eye(4)))

    def statistics(self) -> Mapping[str, float]:
        """Voxels held, clouds integrated, and what was left out and why."""
        return {
            "voxels": self._used,
            "clouds": self._clouds,
            "clouds_without_pose": self._clouds_without_pose,
            "points_out_of_reach": self._points_out_of_reach,
        }

    def process(self, cloud: Message[Cloud]) -> SemanticVoxels | None:
        if cloud.payload.map_from_sensor is None:
            if not self._clouds_without_pose:
                log.warning(
                    "no pose of the cloud at stamp %d; such clouds are left out", cloud.stamp
                )
            self._clouds_without_pose += 1
            return None
        self._integrate(cloud.payload, as_input(cloud.payload.map_from_sensor))
        self._clouds += 1
        return None if self._clouds % self._publish_every else self.snapshot()

    def snapshot(self) -> SemanticVoxels:
        """The map as it stands, as arrays of its own."""
        used = self._used
        indices = unpack(self._keys[:used])
        positions = (indices * self._voxel_m + self._means[:used]).astype(np.float32)
        scores, counts = self._scores[:used].copy(), self._counts_of[:used].copy()
        return SemanticVoxels(self._voxel_m, indices, positions, scores, counts)

    def _integrate(self, cloud: Cloud, map_from_sensor: NDArray[np.float64]) -> None:
        start = 0
        while True:
            self._used, start, beyond = integrate(
                as_input(cloud.points),
                as_input(cloud.log_scores),
                as_input(cloud.evidence),
                map_from_sensor,
                self._voxel_m,
                self._classes,
                self._table,
                self._keys,
                self._scores,
                self._means,
                self._counts_of,
                self._used,
                start,
            )
            self._points_out_of_reach += beyond
            if start == len(cloud.points):
                return
            self._grow()

    def _grow(self) -> None:
        """Twice the voxels; the table stays at most half full."""
        size = 2 * len(self._keys)
        for name in ("_keys", "_scores", "_means", "_counts_of"):
            old = getattr(self, name)
            new = np.empty((size, *old.shape[1:]), dtype=old.dtype)
            new[: self._used] = old
            setattr(self, name, new)
        self._table = np.zeros(4 * size, dtype=np.int32)
        rehash(self._keys, self._used, self._table)
