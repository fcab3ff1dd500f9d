"""The task of learning to segment scans: points of a mixture, drawn, changed and projected."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from stages.kernels.compiled import as_input
from stages.kernels.range_image import fill_channels, project_scan
from tools.train.salsanext import SalsaNext
from tools.train.scan_mix import Mix, Part
from tools.train.scan_recipes import ScanRecipe, azimuth_of_column, varied
from tools.train.scan_sources import LabeledPoints
from tools.train.segmentation_loss import class_weights
from tools.train.segmenter import AROUND_CLASS, WEIGHT_POWER, segmentation_loss

#: Beyond it a simulated scan has no return either.
MAX_RANGE_M = 200.0


class PointSegmenter:
    """Batches of parts of range images (channels, rows, columns), and the loss of a SalsaNext."""

    def __init__(
        self,
        network: SalsaNext,
        mix: Mix,
        recipe: ScanRecipe,
        *,
        channels: int = 5,
        size: tuple[int, int] = (64, 512),
        columns: int = 256,
        batch_size: int = 4,
        max_range_m: float = MAX_RANGE_M,
    ) -> None:
        """A scan is turned by any angle, projected to `size` (rows, columns), and the first
        `columns` are learned from: in half of the draws with a point of a class among them that was
        drawn first, each class of the scan as likely as another. `channels` 4 leaves the remission
        out."""
        self.network = network
        self._mix = mix
        self._recipe = recipe
        self._channels = channels
        self._size = size
        self._columns = columns
        self._batch_size = batch_size
        self._max_range_m = max_range_m
        self._weights = class_weights(mix.counts(), WEIGHT_POWER)

    def batch(self, random: np.random.Generator) -> dict[str, Tensor]:
        drawn = [self._draw(random) for _ in range(self._batch_size)]
        return {
            "input": torch.from_numpy(np.stack([channels for channels, _ in drawn])),
            "classes": torch.from_numpy(np.stack([classes for _, classes in drawn])),
        }

    def loss(self, outputs: Tensor, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return segmentation_loss(outputs.float(), batch["classes"], self._weights)

    def whole(
        self, part: Part, scan: LabeledPoints
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """A scan unchanged, all around, as the network gets it, and the classes of its cells."""
        channels, classes = self._seen(part, scan, scan.points, scan.remission, self._size[1])
        return channels, classes.astype(np.uint8)

    def _draw(self, random: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        part, scan = self._mix.draw(random)
        yaw = float(random.uniform(-np.pi, np.pi))
        mirrored = bool(random.random() < self._recipe.flip)
        if random.random() < AROUND_CLASS and part.labeled:
            yaw = self._towards_class(scan, mirrored, random, yaw)
        points, remission, here = varied(
            scan.points, scan.remission, self._recipe, yaw, mirrored, random
        )
        points[~here] = 0.0
        return self._seen(part, scan, points, remission, self._columns)

    def _towards_class(
        self, scan: LabeledPoints, mirrored: bool, random: np.random.Generator, otherwise: float
    ) -> float:
        """The turn that brings a point of one of the scan's classes into the columns."""
        present = np.flatnonzero(np.bincount(scan.classes)[1:]) + 1
        if len(present) == 0:
            return otherwise
        at = random.choice(np.flatnonzero(scan.classes == random.choice(present)))
        x, y, _ = scan.points[at]
        column = float(random.uniform(0, self._columns - 1))
        azimuth = float(np.arctan2(-y if mirrored else y, x))
        return azimuth_of_column(column, self._size[1]) - azimuth

    def _seen(
        self,
        part: Part,
        scan: LabeledPoints,
        points: NDArray[np.float32],
        remission: NDArray[np.float32],
        columns: int,
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        normal = part.statistics
        nearest, _, _ = project_scan(
            as_input(points), self._size, normal.elevation_rad, self._max_range_m
        )
        nearest = nearest[:, :columns]
        channels = fill_channels(
            as_input(points),
            as_input(remission),
            as_input(nearest),
            as_input(normal.mean[: self._channels]),
            as_input(normal.std[: self._channels]),
            self._max_range_m,
        )
        classes = np.where(nearest >= 0, scan.classes[nearest], 0) if part.labeled else 0 * nearest
        return np.asarray(channels, dtype=np.float32), classes.astype(np.int64)
