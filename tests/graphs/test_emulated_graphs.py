"""What the emulated graphs make of the emulated street, whose classes are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.drivers.run import run_graph
from pipeline.message import Message, Span
from stages.emulated_street import lidar_rays, look_along
from stages.fuse_cloud import FuseCloud
from stages.fuse_image import FuseImage
from stages.fused import FusedImage, FusionStatus
from stages.taxonomy import load_taxonomy
from stages.types import ClassScores, Cloud, DepthImage, Detections, Pose, Scan
from tools.load import open_graph

TWO = Path(__file__).resolve().parents[2] / "graphs" / "emulated_two_cameras.yaml"


@pytest.mark.slow
def test_two_cameras_vote_for_what_both_see_and_all_is_labeled_as_it_is(tmp_path: Path) -> None:
    clouds: list[Cloud] = []
    images: list[FusedImage] = []

    class WatchedFuseCloud(FuseCloud):
        def process(
            self,
            cloud: Message[Scan | Cloud],
            scores: tuple[Message[ClassScores] | None, ...] = (),
            boxes: tuple[Message[Detections] | None, ...] = (),
            trajectory: Span[Pose] = (),
        ) -> Cloud:
            clouds.append(super().process(cloud, scores, boxes, trajectory))
            return clouds[-1]

    class WatchedFuseImage(FuseImage):
        def process(
            self,
            scores: Message[ClassScores],
            boxes: Message[Detections] | None = None,
            thermal: Message[Detections] | None = None,
            depth: Message[DepthImage] | None = None,
            trajectory: Span[Pose] = (),
        ) -> FusedImage:
            images.append(super().process(scores, boxes, thermal, depth, trajectory))
            return images[-1]

    watched = {FuseCloud: WatchedFuseCloud, FuseImage: WatchedFuseImage}
    graph, catalog = open_graph(TWO, out=tmp_path)
    stages = tuple(replace(stage, cls=watched.get(stage.cls, stage.cls)) for stage in graph.stages)
    result = run_graph(replace(graph, stages=stages), catalog, speed=None, duration_s=0.4)
    assert result.failures == ()

    taxonomy = load_taxonomy()
    truth = look_along(lidar_rays(128, 1024), np.eye(4)).label.ravel()
    cloud = clouds[-1]
    assert cloud.voted is not None
    # Bits: 0 the LiDAR's network, then the edges in the order of the file.
    images_of_both, boxes_of_lower_and_thermal = 0b00_0111, 0b11_0001
    both = cloud.voted & images_of_both == images_of_both
    assert 2_000 < both.sum() < 10_000
    boxed = cloud.voted & boxes_of_lower_and_thermal == boxes_of_lower_and_thermal
    assert boxed.sum() > 200
    assert taxonomy.dynamic[truth[boxed]].mean() > 0.97
    said = cloud.log_scores[:, : len(taxonomy)].argmax(axis=1)
    for which in (cloud.evidence, both, boxed):
        assert (said == truth)[which].mean() > 0.95

    assert {image.camera for image in images} == {"front_upper", "front_lower"}
    for image in images[-2:]:
        assert image.status == FusionStatus(0)
        assert image.smoothed > 0.2  # the sky and what is far have no depth
