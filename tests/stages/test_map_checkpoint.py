"""A map that survives kills, full disks and changed graphs."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import DataError
from pipeline.message import Message
from stages import map_checkpoint, voxel_map
from stages.semantic_map import SemanticMap
from stages.types import Cloud, SemanticVoxels
from stages.voxel_map import VoxelMap

TENTH = 100_000_000
FIELDS = ("indices", "positions", "log_scores", "counts")

GRAPH = """\
overflight: 1
graph: mapping
parameters: {dies: false}
stages:
  clouds: {use: my_clouds:Clouds, options: {checkpoint: $out/map.npz, dies: $dies}}
  map:
    use: stages.semantic_map:SemanticMap
    options: {checkpoint: $out/map.npz, checkpoint_s: 0.5}
    inputs: {cloud: {from: clouds, queue: {policy: block, size: 1}}}
  file: {use: stages.sinks.npz:WriteNpz, options: {folder: $out/maps}, inputs: {message: map}}
"""
MY_CLOUDS = """\
import os, signal
from collections.abc import Iterator
from pathlib import Path
import numpy as np
from pipeline.message import Message
from pipeline.stage import Source
from stages.types import Cloud

class Clouds(Source):
    '''Twenty clouds; kills its own process in the middle, once a checkpoint is there.'''

    def __init__(self, *, checkpoint: Path, dies: bool) -> None:
        self.checkpoint, self.dies = checkpoint, dies

    def messages(self) -> Iterator[Message[Cloud]]:
        rng = np.random.default_rng(0)
        for number in range(20):
            if self.dies and number == 12:
                while not self.checkpoint.exists():
                    os.sched_yield()
                os.kill(os.getpid(), signal.SIGKILL)
            points = rng.uniform(0, 5, (200, 3)).astype(np.float32)
            scores = rng.normal(0, 2, (200, 16)).astype(np.float32)
            cloud = Cloud(points, scores, np.ones(200, np.bool_), np.eye(4), "lidar")
            yield Message.at(number * 100_000_000, cloud)
"""


def cloud(number: int) -> Message[Cloud]:
    rng = np.random.default_rng(number)
    points = rng.uniform(0, 3, (100, 3)).astype(np.float32)
    scores = rng.normal(size=(100, 16)).astype(np.float32)
    return Message.at(number * TENTH, Cloud(points, scores, np.ones(100, bool), np.eye(4), "l"))


@contextmanager
def opened(**options: Any) -> Iterator[SemanticMap]:
    stage = SemanticMap(**options)
    try:
        stage.open()
        yield stage
    finally:
        stage.close()


def run(folder: Path, out: str, *settings: str) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "tools.main", "run", "mapping.yaml", "--speed", "max"]
    words += ["--out", out, "--json", *(word for s in settings for word in ("--set", s))]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    return subprocess.run(
        words, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.slow
def test_a_run_that_was_killed_and_begun_again_ends_with_the_same_map(tmp_path: Path) -> None:
    (tmp_path / "my_clouds.py").write_text(MY_CLOUDS)
    (tmp_path / "mapping.yaml").write_text(GRAPH)
    whole = run(tmp_path, "whole")
    assert whole.returncode == 0, whole.stderr
    killed = run(tmp_path, "again", "parameters.dies=true")
    assert killed.returncode == -9
    assert VoxelMap.load(str(tmp_path / "again/map.npz")).used > 0
    resumed = run(tmp_path, "again")
    assert resumed.returncode == 0, resumed.stderr
    skipped = json.loads(resumed.stdout)["stages"]["map"]["statistics"]["clouds_held_before"]
    assert 5 <= skipped <= 12
    last = "maps/00000000001900000000.npz"
    with np.load(tmp_path / "whole" / last) as one, np.load(tmp_path / "again" / last) as other:
        for name in FIELDS:
            assert one[name].tobytes() == other[name].tobytes()


@pytest.mark.parametrize(
    "options",
    [{}, {"horizon": "window-then-infinite", "horizon_scans": 3}, {"max_distance_m": 2.0}],
)
def test_a_map_goes_on_where_it_was_closed(tmp_path: Path, options: dict[str, Any]) -> None:
    def mapped(*parts: range, checkpoint: Path | None) -> SemanticVoxels:
        for part in parts:
            with opened(checkpoint=checkpoint, **options) as stage:
                for number in part:
                    last = stage.process(cloud(number))
        assert last is not None
        return last

    at_once = mapped(range(60), checkpoint=None)
    in_parts = mapped(range(7), range(3, 55), range(60), checkpoint=tmp_path / "deep" / "map.npz")
    for name in FIELDS:
        assert getattr(at_once, name).tobytes() == getattr(in_parts, name).tobytes()


def test_it_is_written_when_it_is_due_in_the_clouds_time(tmp_path: Path) -> None:
    path = tmp_path / "map.npz"
    with opened(checkpoint=path, checkpoint_s=1.0) as stage:
        for number in range(10):
            stage.process(cloud(number))
        assert stage.statistics()["checkpoints_written"] == 0
        stage.process(cloud(10))
        checkpoint = stage._checkpoint
        assert checkpoint is not None
        assert checkpoint._writing is not None
        checkpoint._writing.result()
        assert stage.statistics()["checkpoints_written"] == 1
        with np.load(path) as content:
            assert (content["clouds"], content["stamp"]) == (11, 10 * TENTH)
        before = path.read_bytes()
        stage.process(cloud(11))
        assert path.read_bytes() == before, "what is written is a copy of its instant"


def test_a_write_that_lasts_is_waited_for_by_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import threading

    go_on = threading.Event()
    monkeypatch.setattr(map_checkpoint.os, "fsync", lambda _: go_on.wait(30))
    with opened(checkpoint=tmp_path / "map.npz", checkpoint_s=0.1) as stage:
        for number in range(5):
            stage.process(cloud(number))
        assert stage.statistics()["checkpoints_late"] == 3
        assert stage.statistics()["clouds"] == 5
        go_on.set()
    with np.load(tmp_path / "map.npz") as content:
        assert content["clouds"] == 5


def test_a_failed_write_leaves_the_file_before_it_and_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "map.npz"
    with opened(checkpoint=path) as stage:
        stage.process(cloud(0))
    before = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch, opened(checkpoint=path, checkpoint_s=0.1) as stage:
        patch.setattr(map_checkpoint.os, "fsync", full)
        with caplog.at_level(logging.WARNING):
            for number in range(1, 3):
                stage.process(cloud(number))
            assert stage._checkpoint is not None
            assert stage._checkpoint._writing is not None
            stage._checkpoint._writing.result()
        assert stage.statistics()["checkpoints_failed"] == 1
        assert "No space left" in caplog.text
        assert path.read_bytes() == before
        assert [file.name for file in tmp_path.iterdir()] == ["map.npz"]
        patch.undo()


def test_a_checkpoint_of_another_map_is_refused_and_left_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "map.npz"
    with opened(checkpoint=path, voxel_m=0.25) as stage:
        stage.process(cloud(0))
    kept = path.read_bytes()
    with pytest.raises(DataError, match=r"map.npz: its map has voxel_m 0\.25, the graph says 0\.5"):
        SemanticMap(checkpoint=path, voxel_m=0.5).run_once(cloud(1))
    with pytest.raises(DataError, match="has horizon infinite, the graph says window-drop"):
        SemanticMap(checkpoint=path, horizon="window-drop").run_once(cloud(1))
    with monkeypatch.context() as patch:
        patch.setattr(voxel_map, "FORMAT", 2)
        with pytest.raises(DataError, match=r"format is 1, and 2 can be read.*move it away"):
            SemanticMap(checkpoint=path).run_once(cloud(1))
    assert path.read_bytes() == kept
    path.write_bytes(kept[: len(kept) // 2])
    with pytest.raises(DataError, match="cannot go on from it"):
        SemanticMap(checkpoint=path).run_once(cloud(1))
    np.savez(path, **VoxelMap(voxel_m=0.25, classes=15).state())
    with pytest.raises(DataError, match="cannot go on from it"):
        SemanticMap(checkpoint=path).run_once(cloud(1))


def test_what_a_killed_writer_left_is_cleared_away(tmp_path: Path) -> None:
    (tmp_path / ".map.npz.abcd").write_bytes(b"half")
    with opened(checkpoint=tmp_path / "map.npz") as stage:
        stage.process(cloud(0))
    assert [file.name for file in tmp_path.iterdir()] == ["map.npz"]


def test_a_wrong_period_is_said() -> None:
    with pytest.raises(ValueError, match="checkpoint_s must be above 0, not 0"):
        SemanticMap(checkpoint=Path("map.npz"), checkpoint_s=0)
