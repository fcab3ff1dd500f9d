"""Labels read back from what our sinks write and from what others do."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.errors import DataError
from pipeline.message import Message
from stages.labeled_files import LabelSet, holds_map, read_frame, read_map
from stages.sinks.npz import WriteNpz
from stages.sinks.ply import WritePly
from stages.types import Cloud, SemanticVoxels
from stages.voxel_map import VoxelMap

OWN = LabelSet()


def cloud() -> Cloud:
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 4, (50, 3)).astype(np.float32)
    scores = rng.normal(0, 2, (50, 16)).astype(np.float32)
    scores[:, 15] = -1e4
    return Cloud(points, scores, rng.random(50) < 0.8, np.eye(4), "lidar")


def test_a_cloud_s_npz_gives_class_place_and_sensor(tmp_path: Path) -> None:
    fused = cloud()
    WriteNpz(folder=tmp_path).process(Message.at(7, fused))
    (path,) = tmp_path.iterdir()
    frame = read_frame(path, OWN)
    expected = np.where(fused.evidence, fused.log_scores[:, :15].argmax(axis=1), 0)
    np.testing.assert_array_equal(frame.labels, expected)
    assert frame.points is not None
    np.testing.assert_array_equal(frame.points, fused.points)
    assert frame.sensor == "lidar"
    assert not holds_map(path)


def test_one_map_reads_the_same_from_ply_npz_and_checkpoint(tmp_path: Path) -> None:
    voxel_map = VoxelMap(voxel_m=0.5, classes=15)
    voxel_map.integrate(cloud(), np.eye(4), 0)
    voxels = voxel_map.snapshot()
    with (tmp_path / "saved.npz").open("wb") as file:
        voxel_map.save(file)
    sink = WritePly(path=tmp_path / "map.ply")
    sink.process(Message.at(0, voxels))
    sink.close()
    WriteNpz(folder=tmp_path / "npz").process(Message.at(0, voxels))
    (npz,) = (tmp_path / "npz").iterdir()
    for path in (tmp_path / "saved.npz", tmp_path / "map.ply", npz):
        assert holds_map(path)
        read = read_map(path, OWN)
        np.testing.assert_array_equal(read.points, voxels.positions)
        np.testing.assert_array_equal(read.labels, voxels.log_scores[:, :15].argmax(axis=1))
        assert read.voxel_m == 0.5
        assert read.entropy is not None


def test_semantickitti_s_instances_are_left_off_and_ids_become_ours(tmp_path: Path) -> None:
    path = tmp_path / "000000.label"
    np.array([10 | 7 << 16, 40, 99, 252], np.uint32).tofile(path)
    assert read_frame(path, LabelSet("semantickitti")).labels.tolist() == [13, 3, 0, 13]
    with pytest.raises(
        DataError, match=r"000000.label: label set 'overflight' has no class 40, 99"
    ):
        read_frame(path, OWN)
    assert read_frame(path, LabelSet("overflight", (40, 99, 252))).labels.tolist() == [10, 0, 0, 0]


def test_masks_are_gray_and_npz_may_name_labels(tmp_path: Path) -> None:
    mask = np.array([[3, 255]], np.uint8)
    cv2.imwrite(str(tmp_path / "0.png"), mask)
    assert read_frame(tmp_path / "0.png", LabelSet(ignored=(255,))).labels.tolist() == [[3, 0]]
    cv2.imwrite(str(tmp_path / "1.png"), np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(DataError, match=r"1\.png: a color picture; a mask has one channel"):
        read_frame(tmp_path / "1.png", OWN)
    np.savez(tmp_path / "2.npz", points=np.zeros((2, 3)), labels=np.array([5, 13]))
    assert read_frame(tmp_path / "2.npz", OWN).labels.tolist() == [5, 13]
    annotated = read_map(tmp_path / "2.npz", OWN)
    assert (annotated.labels.tolist(), annotated.voxel_m) == ([5, 13], None)


def test_files_that_hold_no_labels_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.label").write_bytes(b"12345")
    (tmp_path / "b.npz").write_bytes(b"PK")
    np.savez(tmp_path / "c.npz", depth=np.zeros(3))
    np.savez(tmp_path / "g.npz", boxes=np.zeros((1, 4)), classes=np.zeros(1))
    np.savez(tmp_path / "d.npz", positions=np.zeros((3, 3)), labels=np.zeros(2, np.uint8))
    np.savez(tmp_path / "e.npz", positions=np.zeros((3, 3)), log_scores=np.zeros((3, 12)))
    whole = (tmp_path / "e.npz").read_bytes()
    (tmp_path / "f.npz").write_bytes(whole[: len(whole) // 2])
    for name, what in (
        ("f.npz", "no npz file"),
        ("g.npz", "holds the boxes of a detector"),
        ("a.label", "5 bytes are no rows of uint32"),
        ("b.npz", "no npz file"),
        ("c.npz", "holds neither log_scores nor one of class"),
        ("e.npz", r"log_scores of shape \(3, 12\)"),
        ("none.label", "cannot be read"),
    ):
        with pytest.raises(DataError, match=f"{name}: {what}"):
            read_frame(tmp_path / name, OWN)
    with pytest.raises(DataError, match=r"d\.npz: 2 labels for 3 points"):
        read_map(tmp_path / "d.npz", OWN)
    with pytest.raises(DataError, match=r"c\.npz: holds no points"):
        read_map(tmp_path / "c.npz", OWN)
    plain = SemanticVoxels(1.0, *(np.zeros((0, k)) for k in (3, 3, 16)), np.zeros(0))  # type: ignore[arg-type]
    WriteNpz(folder=tmp_path / "npz").process(Message.at(0, plain))
    assert len(read_map(next((tmp_path / "npz").iterdir()), OWN).labels) == 0
    with pytest.raises(DataError, match=r"no label set 'kitti'.*or 'overflight' for our own ids"):
        LabelSet.named("kitti")
