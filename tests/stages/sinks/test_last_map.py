"""What the sinks of the finished map have in common."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.message import Message
from stages.sinks.last_map import LastMap
from stages.types import SemanticVoxels


class Written(LastMap):
    """Remembers what it was told to write."""

    def write(self, path: Path, voxels: SemanticVoxels) -> None:
        self.written = voxels


def written(min_confidence: float) -> SemanticVoxels:
    log_scores = np.zeros((3, 16), np.float32)
    log_scores[:, 15] = -1e4
    log_scores[1, 3], log_scores[2, 13] = np.log(14.0), 9.0  # certain to 1/15, 1/2 and 0.998
    indices = np.arange(9, dtype=np.int32).reshape(3, 3)
    voxels = SemanticVoxels(
        0.25, indices, indices.astype(np.float32), log_scores, np.arange(3, dtype=np.int32)
    )
    sink = Written(path=Path("map"), min_confidence=min_confidence)
    sink.run_once(Message.at(0, voxels))
    return sink.written


@pytest.mark.parametrize(("least", "kept"), [(0.0, [0, 1, 2]), (0.49, [1, 2]), (0.8, [2])])
def test_only_voxels_that_are_certain_enough_are_written(least: float, kept: list[int]) -> None:
    voxels = written(least)
    assert voxels.counts.tolist() == kept
    assert voxels.indices[:, 0].tolist() == [3 * k for k in kept]
    assert len(voxels.positions) == len(voxels.log_scores) == len(kept)


def test_without_a_map_nothing_is_written(tmp_path: Path) -> None:
    sink = Written(path=tmp_path / "map")
    sink.open()
    sink.close()
    assert not hasattr(sink, "written")


def test_a_confidence_is_a_probability() -> None:
    with pytest.raises(ValueError, match=r"min_confidence must lie in 0\.\.1, not 80"):
        Written(path=Path("map"), min_confidence=80)
