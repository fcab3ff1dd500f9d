"""What the sinks of the finished map have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.message import Message
from pipeline.stage import Stage
from stages.kernels.probability import softmax
from stages.taxonomy import load_taxonomy
from stages.types import SemanticVoxels


class LastMap(Stage, ABC):
    """Keeps the last map it gets and writes it when it closes; subclasses define `write`."""

    inline = True

    def __init__(self, *, path: Path, min_confidence: float = 0.0) -> None:
        """`min_confidence` leaves out the voxels whose likeliest class is less probable."""
        if not 0 <= min_confidence <= 1:
            raise ValueError(f"min_confidence must lie in 0..1, not {min_confidence}")
        self._path = Path(path)
        self._min_confidence = min_confidence
        self._last: SemanticVoxels | None = None

    def process(self, map: Message[SemanticVoxels]) -> None:
        self._last = map.payload

    def close(self) -> None:
        if self._last is not None:
            voxels, self._last = self._last, None
            self.write(self._path, confident(voxels, self._min_confidence))

    @abstractmethod
    def write(self, path: Path, voxels: SemanticVoxels) -> None:
        """Write the map to `path`, whole or not at all."""


def confident(voxels: SemanticVoxels, least: float) -> SemanticVoxels:
    """The voxels whose likeliest class has at least the probability `least`."""
    if least == 0:
        return voxels
    kept = softmax(voxels.log_scores, len(load_taxonomy())).max(axis=-1) >= np.float32(least)
    return chosen(voxels, kept)


def chosen(voxels: SemanticVoxels, kept: NDArray[np.bool_]) -> SemanticVoxels:
    """Those of the voxels (n,)."""
    return replace(
        voxels,
        indices=voxels.indices[kept],
        positions=voxels.positions[kept],
        log_scores=voxels.log_scores[kept],
        counts=voxels.counts[kept],
    )
