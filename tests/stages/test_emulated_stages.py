from __future__ import annotations

import time

import numpy as np
import pytest

from accelerators.emulated import Emulated
from accelerators.registry import Registry
from pipeline.message import Message
from stages.emulated import (
    EmulatedFuseCloud,
    EmulatedFuseImage,
    EmulatedSegmentScan,
    EmulatedSemanticMap,
)
from stages.sources.emulated import EmulatedLidar
from stages.types import CHANNELS, ClassScores, Cloud, Detections, Pose, Scan


def scan() -> Message[Scan]:
    source = EmulatedLidar(rows=4, columns=8, count=1)
    source.open()
    return next(source.messages())


def cloud() -> Message[Cloud]:
    model = Registry.open().load("segment-scan", Emulated(latency_ms={"segment-scan": 0}))
    found = EmulatedSegmentScan().run_once(scan(), model=model)
    return Message.at(0, found)


def test_a_segmented_scan_keeps_its_points() -> None:
    found = cloud().payload
    assert found.points.shape == (32, 3)
    assert found.log_scores.shape == (32, CHANNELS)
    assert found.evidence.all()
    assert found.sensor == "lidar"


def test_a_fused_cloud_takes_the_last_pose_and_the_map_stays_empty() -> None:
    pose = np.eye(4)
    pose[0, 3] = 7
    span = (Message.at(0, Pose(np.eye(4))), Message.at(9, Pose(pose)))
    fused = EmulatedFuseCloud().run_once(cloud(), None, (None, None), span)
    assert fused.map_from_sensor is pose
    assert EmulatedFuseCloud().run_once(cloud(), None, (), ()).map_from_sensor is None
    voxels = EmulatedSemanticMap().run_once(Message.at(0, fused))
    assert voxels.indices.shape == (0, 3)


def test_a_fused_image_is_the_segmentation() -> None:
    grid = np.zeros((1, 2, 2, CHANNELS), np.int8)
    rects = np.array([[0, 0, 4, 4]], np.float32)
    scores = Message.at(0, ClassScores(grid, rects, 1.0, 0, True, "rgb", (4, 4)))
    none = np.zeros((0, 4), np.float32)
    boxes = Message.at(0, Detections(none, np.zeros(0, np.int64), np.zeros(0, np.float32), "rgb"))
    assert EmulatedFuseImage().run_once(scores, boxes, None) is scores.payload


def test_a_run_burns_the_declared_cpu_time() -> None:
    model = Registry.open().load("segment-scan", Emulated(latency_ms={"segment-scan": 0}))
    start = time.thread_time()
    EmulatedSegmentScan(burn_ms=10).run_once(scan(), model=model)
    assert 0.010 <= time.thread_time() - start < 0.030


@pytest.mark.parametrize(
    "make", [EmulatedSegmentScan, EmulatedFuseImage, EmulatedFuseCloud, EmulatedSemanticMap]
)
def test_a_negative_burn_is_a_bad_option(make: type) -> None:
    with pytest.raises(ValueError, match="burn_ms must not be negative"):
        make(burn_ms=-1)
