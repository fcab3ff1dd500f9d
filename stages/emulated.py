"""Emulated stages: the ports and the CPU time of stages whose content does not matter to a graph.

They let the whole graph of the paper run without data or weights, so that scheduling, queues and
synchronization can be watched and measured. Their results are empty or uniform, and every name says
that they are emulated. `burn_ms` is CPU time per run, spent without the GIL as a compiled kernel
spends it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.message import Message, Span
from pipeline.model import Tensor, Tensors
from pipeline.stage import ModelStage, Stage
from stages.kernels.burn import burn
from stages.types import (
    CHANNELS,
    ClassScores,
    Cloud,
    Detections,
    Pose,
    Scan,
    SemanticVoxels,
)


def _checked(burn_ms: float) -> float:
    if not burn_ms >= 0:
        raise ValueError(f"burn_ms must not be negative, not {burn_ms}")
    return burn_ms


class EmulatedSegmentScan(ModelStage):
    """Stands for the LiDAR segmentation: half of `burn_ms` before the network, half after it."""

    def __init__(self, *, burn_ms: float = 0.0) -> None:
        self.burn_ms = _checked(burn_ms)

    def open(self) -> None:
        spec = self.model
        self._input = Tensor(np.zeros((1, *spec.input_shape), dtype=spec.input_dtype))
        self._scores = _uniform(0)

    def prepare(self, scan: Message[Scan]) -> Tensors:
        burn(self.burn_ms / 2)
        return {self.model.input_name: self._input}

    def finish(self, outputs: Tensors, scan: Message[Scan]) -> Cloud:
        burn(self.burn_ms / 2)
        points = scan.payload.points
        if len(self._scores) != len(points):
            self._scores = _uniform(len(points))
        evidence = np.ones(len(points), dtype=np.bool_)
        return Cloud(points, self._scores, evidence, None, scan.payload.sensor)


class EmulatedFuseImage(Stage):
    """Stands for the fusion of a segmentation with RGB and thermal detections in the image."""

    def __init__(self, *, burn_ms: float = 0.0) -> None:
        self.burn_ms = _checked(burn_ms)

    def process(
        self,
        scores: Message[ClassScores],
        boxes: Message[Detections],
        thermal: Message[Detections] | None,
    ) -> ClassScores:
        burn(self.burn_ms)
        return scores.payload


class EmulatedFuseCloud(Stage):
    """Stands for the fusion of image, detections and LiDAR in the scan's points."""

    def __init__(self, *, burn_ms: float = 0.0) -> None:
        self.burn_ms = _checked(burn_ms)

    def process(
        self,
        cloud: Message[Cloud],
        scores: Message[ClassScores] | None,
        boxes: tuple[Message[Detections] | None, ...],
        trajectory: Span[Pose],
    ) -> Cloud:
        burn(self.burn_ms)
        fused = cloud.payload
        pose = trajectory[-1].payload.map_from_base if trajectory else None
        return Cloud(fused.points, fused.log_scores, fused.evidence, pose, fused.sensor)


class EmulatedSemanticMap(Stage):
    """Stands for the semantic voxel map; the map stays empty."""

    def __init__(self, *, burn_ms: float = 0.0) -> None:
        self.burn_ms = _checked(burn_ms)

    def open(self) -> None:
        self._empty = SemanticVoxels(
            voxel_m=0.25,
            indices=np.zeros((0, 3), dtype=np.int32),
            positions=np.zeros((0, 3), dtype=np.float32),
            log_scores=_uniform(0),
            counts=np.zeros(0, dtype=np.int32),
        )

    def process(self, cloud: Message[Cloud]) -> SemanticVoxels:
        burn(self.burn_ms)
        return self._empty


def _uniform(rows: int) -> NDArray[np.float32]:
    scores = np.zeros((rows, CHANNELS), dtype=np.float32)
    scores.flags.writeable = False
    return scores
