"""Label files and masks as they lie on the disk."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.errors import StageError
from pipeline.message import Message
from stages.fused import FusedImage, FusionStatus
from stages.sinks.labels import WriteLabels, WriteMasks
from stages.types import Cloud

TENTH = 100_000_000


def cloud(stamp: int) -> Message[Cloud]:
    log_scores = np.zeros((3, 16), np.float32)
    log_scores[0, 13] = log_scores[1, 3] = log_scores[2, 8] = 4.0
    evidence = np.array([True, False, True])
    return Message.at(stamp, Cloud(np.ones((3, 3), np.float32), log_scores, evidence, None, "l"))


def test_every_point_has_its_class_and_0_without_evidence(tmp_path: Path) -> None:
    sink = WriteLabels(folder=tmp_path / "labels")
    sink.process(cloud(0))
    sink.process(cloud(12 * TENTH + 3_000_000))
    assert sorted(path.name for path in (tmp_path / "labels").iterdir()) == [
        "000000.label",
        "000012.label",
    ]
    assert np.fromfile(tmp_path / "labels/000012.label", np.uint32).tolist() == [13, 0, 8]


def test_ids_of_another_label_set_are_its_first_and_0_where_it_has_none(tmp_path: Path) -> None:
    WriteLabels(folder=tmp_path, label_set="semantickitti").process(cloud(0))
    assert np.fromfile(tmp_path / "000000.label", np.uint32).tolist() == [10, 0, 0]


def test_a_frame_is_written_once_and_the_way_out_is_said(tmp_path: Path) -> None:
    sink = WriteLabels(folder=tmp_path, rate_hz=1.0)
    sink.process(cloud(0))
    with pytest.raises(StageError, match=r"frame 0 at 1\.0 Hz, which is written; set rate_hz"):
        sink.process(cloud(TENTH))
    with pytest.raises(StageError, match="before the first"):
        sink.process(cloud(-50 * TENTH))
    with pytest.raises(ValueError, match="rate_hz must be above 0"):
        WriteLabels(folder=tmp_path, rate_hz=0)
    with pytest.raises(ValueError, match="did you mean 'semantickitti'"):
        WriteLabels(folder=tmp_path, label_set="semantikitti")


def test_a_mask_is_a_gray_picture_of_class_ids(tmp_path: Path) -> None:
    mask = np.array([[0, 13], [3, 14]], np.uint8)
    fused = FusedImage(mask, np.ones((2, 2), np.float32), None, "rgb", FusionStatus(0), 0.0)
    WriteMasks(folder=tmp_path).process(Message.at(TENTH, fused))
    read = cv2.imread(str(tmp_path / "00000000000100000000.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(read, mask)


def test_masks_of_several_cameras_share_a_folder(tmp_path: Path) -> None:
    sink = WriteMasks(folder=tmp_path, by_camera=True)
    for camera in ("rgb", "rgb_lower"):
        mask, sure = np.ones((2, 3), np.uint8), np.ones((2, 3), np.float32)
        fused = FusedImage(mask, sure, None, camera, FusionStatus(0), 0.0)
        sink.process(Message.at(TENTH, fused))
    names = [file.name for file in sorted(tmp_path.iterdir())]
    assert names == ["00000000000100000000_rgb.png", "00000000000100000000_rgb_lower.png"]
