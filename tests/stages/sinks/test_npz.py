"""Archives, read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import StageError
from pipeline.message import Message
from stages.sinks.npz import WriteNpz
from stages.types import Scan


def test_an_archive_holds_every_field_and_the_times(tmp_path: Path) -> None:
    points = np.arange(6, dtype=np.float32).reshape(2, 3)
    message = Message.at(5, Scan(points, None, None, (1, 2), "lidar"), begin=4, end=9)
    WriteNpz(folder=tmp_path).run_once(message)
    with np.load(tmp_path / "00000000000000000005.npz") as content:
        assert sorted(content) == ["begin", "end", "points", "sensor", "shape", "stamp"]
        np.testing.assert_array_equal(content["points"], points)
        assert [int(content[name]) for name in ("begin", "stamp", "end")] == [4, 5, 9]
        assert str(content["sensor"]) == "lidar"


def test_every_nth_message_is_written(tmp_path: Path) -> None:
    sink = WriteNpz(folder=tmp_path, every=2)
    for stamp in range(3):
        sink.process(Message.at(stamp, Scan(np.zeros((1, 3), np.float32), None, None, None, "a")))
    assert len(list(tmp_path.iterdir())) == 2


def test_a_payload_that_is_no_dataclass_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StageError, match="cannot write a int"):
        WriteNpz(folder=tmp_path).run_once(Message.at(0, 3))
    with pytest.raises(ValueError, match="every must be at least 1"):
        WriteNpz(folder=tmp_path, every=0)
