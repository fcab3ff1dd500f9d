"""PLY files, parsed back from their header as any reader does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import DataError
from pipeline.message import Message
from stages.sinks.ply import WriteCloudPly, WritePly
from stages.taxonomy import load_taxonomy
from stages.types import Cloud, SemanticVoxels

NUMPY_TYPES = {"float": "<f4", "uchar": "u1"}


def read_ply(path: Path) -> np.ndarray:
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = header.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    fields = [line.split()[1:] for line in lines if line.startswith("property")]
    vertices = np.frombuffer(body, [(name, NUMPY_TYPES[kind]) for kind, name in fields])
    assert len(vertices) == count
    return vertices


def voxels(count: int, label: int = 3) -> Message[SemanticVoxels]:
    log_scores = np.zeros((count, 16), np.float32)
    log_scores[:, label] = 5.0
    positions = np.arange(3 * count, dtype=np.float32).reshape(-1, 3)
    payload = SemanticVoxels(
        0.25,
        np.floor(positions / 0.25).astype(np.int32),
        positions,
        log_scores,
        np.ones(count, np.int32),
    )
    return Message.at(count, payload)


def test_the_last_map_is_written_on_close_in_class_colors(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "map.ply"
    sink = WritePly(path=path)
    sink.open()
    sink.process(voxels(3))
    sink.process(voxels(5, label=13))
    assert not path.exists()
    sink.close()
    vertices = read_ply(path)
    assert np.stack([vertices[axis] for axis in "xyz"], axis=1).tolist() == (
        voxels(5).payload.positions.tolist()
    )
    assert vertices["class"].tolist() == [13] * 5
    rgb = [vertices[name][0] for name in ("red", "green", "blue")]
    assert rgb == load_taxonomy().colors[13].tolist()
    expected = np.exp(5) / (np.exp(5) + 14)
    np.testing.assert_allclose(vertices["confidence"], expected, rtol=1e-5)
    assert [p.name for p in path.parent.iterdir()] == ["map.ply"]


def test_without_a_map_nothing_is_written(tmp_path: Path) -> None:
    sink = WritePly(path=tmp_path / "map.ply")
    sink.open()
    sink.close()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("unlabeled", [False, True])
def test_a_cloud_file_holds_the_points_with_evidence_or_all(
    tmp_path: Path, unlabeled: bool
) -> None:
    points = np.array([[1, 0, 0], [2, 0, 0], [0, 0, 0], [np.nan, 0, 0]], np.float32)
    log_scores = np.zeros((4, 16), np.float32)
    log_scores[:, 5] = 3.0
    cloud = Cloud(points, log_scores, np.array([True, False, False, False]), None, "lidar")
    WriteCloudPly(folder=tmp_path, unlabeled=unlabeled).run_once(Message.at(7, cloud))
    vertices = read_ply(tmp_path / "00000000000000000007.ply")
    assert vertices["x"].tolist() == ([1, 2] if unlabeled else [1])
    assert vertices["class"].tolist() == ([5, 0] if unlabeled else [5])


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    sink = WritePly(path=tmp_path / "file" / "map.ply")
    sink.process(voxels(1))
    with pytest.raises(DataError, match=r"cannot write .*map\.ply"):
        sink.close()
