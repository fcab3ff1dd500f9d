"""Observations come back from their files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import DataError, StageError
from pipeline.message import Message
from stages.observed import Said, read_observation
from stages.sinks.observations import WriteObservations
from stages.types import Cloud, Scan


def cloud(n: int = 4) -> Cloud:
    scores = np.zeros((n, 16), np.float32)
    scores[:, 15] = -1e4
    scores[1, 3], scores[-2, 13] = 5.0, 2.5
    evidence = np.array([False, True, True, False])[:n]
    points = np.arange(3 * n, dtype=np.float32).reshape(n, 3)
    return Cloud(points, scores, evidence, np.eye(4), "lidar", shape=(2, n // 2))


def scan(n: int = 4) -> Scan:
    remission = np.linspace(0, 1, n, dtype=np.float32)
    return Scan(cloud(n).points, remission, None, (2, n // 2), "lidar")


def test_a_scan_and_what_was_said_of_it_come_back(tmp_path: Path) -> None:
    said = replace(Message.at(70, cloud()), degraded=True)
    WriteObservations(folder=tmp_path).process(said, Message.at(70, scan()))
    one = read_observation(tmp_path / f"{70:020d}.npz")
    assert (one.stamp, one.sensor, one.shape, one.degraded, one.fused) == (
        70, "lidar", (2, 2), True, None,
    )  # fmt: skip
    np.testing.assert_array_equal(one.points, cloud().points)
    np.testing.assert_array_equal(one.remission, scan().remission)
    assert one.camera.index.tolist() == [1, 2]
    again = one.cloud(one.camera)
    np.testing.assert_array_equal(again.points, cloud().points[1:3])
    np.testing.assert_array_equal(again.log_scores.argmax(axis=1), [3, 13])
    np.testing.assert_allclose(again.log_scores[0, 3] - again.log_scores[0, 0], 5.0, atol=0.01)
    assert (again.log_scores[:, 15] == -1e4).all()


def test_the_evidence_with_the_lidar_network_is_kept_apart(tmp_path: Path) -> None:
    both = replace(cloud(), evidence=np.ones(4, np.bool_))
    WriteObservations(folder=tmp_path).process(
        Message.at(70, cloud()), Message.at(70, scan()), Message.at(70, both)
    )
    one = read_observation(tmp_path / f"{70:020d}.npz")
    assert one.fused is not None
    assert (len(one.camera.index), len(one.fused.index)) == (2, 4)


def test_a_point_of_which_nothing_is_said_takes_no_room() -> None:
    silent = replace(cloud(), evidence=np.zeros(4, np.bool_))
    assert Said.of(silent).log_scores.shape == (0, 16)


def test_another_scan_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StageError, match="2 points beside a cloud of 4"):
        WriteObservations(folder=tmp_path).process(Message.at(0, cloud()), Message.at(0, scan(2)))


def test_a_file_that_is_cut_short_is_named(tmp_path: Path) -> None:
    WriteObservations(folder=tmp_path).process(Message.at(0, cloud()), Message.at(0, scan()))
    file = tmp_path / f"{0:020d}.npz"
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(DataError, match=r"\.npz: is no observation"):
        read_observation(file)
