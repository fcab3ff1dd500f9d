"""The paper's whole graph on a simulated flight, and what geometry and fusion alone cost in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.drivers.run import run_graph
from pipeline.message import Message
from pipeline.stage import Stage
from stages.fused import FusedImage
from stages.kernels.evaluation import agreement, map_confusion, scan_confusion
from stages.labels import LabeledVoxels, Labels
from stages.sources.recording import Recording
from stages.taxonomy import load_taxonomy
from stages.types import Cloud, SemanticVoxels
from tools.load import open_graph

pytestmark = pytest.mark.slow

GRAPHS = Path(__file__).resolve().parents[2] / "graphs"

#: Everything that draws or writes.
SINKS = (
    *("image_file", "image_lower_file", "thermal_file", "cloud_file"),
    *("map_file", "top_view", "oblique_view", "recent_map"),
)
#: The stages behind the fused cloud of the quarter-size scan.
COARSE = "stages.fuse_cloud.options.vertical_pitch_deg=2.9"

#: What stands in for the devices: answers of zero, which say nothing, but of every pixel and point.
EMULATED = """\
overflight: 1
devices:
  edgetpu: null
  igpu: null
  cpu: null
  emulated:
    use: accelerators.emulated:Emulated
    latency_ms: {segment-rgb: 0, detect-rgb: 0, detect-thermal: 0, segment-scan: 0}
stages:
  segment_rgb: {executor: emulated}
  segment_rgb_lower: {executor: emulated}
  detect_rgb: {executor: emulated}
  detect_rgb_lower: {executor: emulated}
  detect_thermal: {executor: emulated}
  segment_scan: {executor: emulated}
"""
#: Leaves to the cameras what the scan's points are.
CAMERAS = """\
overflight: 1
stages:
  segment_scan: null
  labels_scan: null
  detect_rgb: null
  detect_rgb_lower: null
  detect_thermal: null
  fuse_image: {inputs: {boxes: null, thermal: null}}
  fuse_image_lower: {inputs: {boxes: null, thermal: null}}
  fuse_cloud: {inputs: {cloud: lidar, boxes: null}}
"""


class Late(Recording):
    """Poses whose clock is 0.3 s off."""

    def messages(self) -> Iterator[Message[Any]]:
        for message in super().messages():
            stamp = message.stamp + 300_000_000
            yield replace(message, stamp=stamp, begin=stamp, end=stamp)


def fly(
    graph: str,
    flight: Path,
    out: Path,
    watched: Sequence[str],
    settings: Sequence[str] = (),
    overlays: Sequence[Path] = (),
    exchanged: dict[str, type[Stage]] | None = None,
) -> dict[str, list[Message[Any]]]:
    """Run a graph without its sinks; what the stages `watched` received or made, by name."""
    made: dict[str, list[Message[Any]]] = {name: [] for name in watched}
    settings = [f"parameters.flight={flight}", COARSE, *settings]
    settings += [f"stages.{sink}=null" for sink in SINKS]
    loaded, catalog = open_graph(GRAPHS / f"{graph}.yaml", settings, overlays, out=out)

    def watch(name: str, cls: type[Stage]) -> type[Stage]:
        def process(self: Any, *warm_up: Any, **inputs: Any) -> Any:
            result = cls.process(self, *warm_up, **inputs)  # type: ignore[attr-defined]
            if inputs and result is not None:
                trigger = next(iter(inputs.values()))
                made[name].append(Message.at(trigger.stamp, result))
            return result

        return type(cls.__name__, (cls,), {"process": process})

    stages = []
    for stage in loaded.stages:
        cls = (exchanged or {}).get(stage.name, stage.cls)
        stages.append(replace(stage, cls=watch(stage.name, cls) if stage.name in made else cls))
    result = run_graph(replace(loaded, stages=tuple(stages)), catalog, speed=None)
    assert result.failures == ()
    assert result.report["ledger_balanced"]
    return made


def recorded(flight: Path, topic: str) -> list[Message[Any]]:
    source = Recording(path=flight, topic=topic)
    source.open()
    return list(source.messages())


def map_iou(made: SemanticVoxels, flight: Path) -> float:
    """Mean IoU over the classes of the true voxels that the map holds."""
    true: LabeledVoxels = recorded(flight, "truth/map")[0].payload
    said = made.log_scores[:, : len(load_taxonomy())].argmax(axis=1)
    return agreement(map_confusion(true.indices, true.classes, made.indices, said)).mean


def test_with_the_truth_for_networks_the_map_is_true(tiny_flight: Path, tmp_path: Path) -> None:
    made = fly("uav_truth", tiny_flight, tmp_path, ["semantic_map"])["semantic_map"]
    assert len(made) == 4
    iou = map_iou(made[-1].payload, tiny_flight)
    late = fly("uav_truth", tiny_flight, tmp_path, ["semantic_map"], exchanged={"odometry": Late})[
        "semantic_map"
    ]
    assert iou > 0.94
    assert map_iou(late[-1].payload, tiny_flight) < 0.8, "a clock that is off must show"


def test_cameras_alone_put_their_classes_where_they_are(tiny_flight: Path, tmp_path: Path) -> None:
    overlay = tmp_path / "cameras.yaml"
    overlay.write_text(CAMERAS)
    made = fly("uav_truth", tiny_flight, tmp_path, ["semantic_map"], overlays=[overlay])
    last: SemanticVoxels = made["semantic_map"][-1].payload
    assert len(last.indices) > 2000
    assert map_iou(last, tiny_flight) > 0.8  # at a quarter of the resolution


def test_fused_beats_a_poor_lidar_network_in_the_view_of_the_cameras(
    tiny_flight: Path, tmp_path: Path
) -> None:
    poor = "stages.segment_scan.options={mistakes: 0.4, confidence: 0.6}"
    made = fly("uav_truth", tiny_flight, tmp_path, ["segment_scan", "fuse_cloud"], [poor])
    true: list[Message[Labels]] = recorded(tiny_flight, "truth/lidar")
    matrices: dict[str, Any] = {"single": 0, "fused": 0}
    for labels, single, fused in zip(true, made["segment_scan"], made["fuse_cloud"], strict=True):
        classes = labels.payload.classes.ravel()
        assert fused.payload.voted is not None
        seen = fused.payload.voted & 0b110 != 0
        for name, cloud in (("single", single.payload), ("fused", fused.payload)):
            said = cloud.log_scores[:, : len(load_taxonomy())].argmax(axis=1)
            matrices[name] += scan_confusion(classes, said, visible=seen)
    iou = {name: agreement(matrix).mean for name, matrix in matrices.items()}
    assert iou["single"] < 0.5, iou
    assert iou["fused"] > 0.8, iou


def test_both_cameras_reach_the_fused_images_and_the_fused_cloud(
    tiny_flight: Path, tmp_path: Path
) -> None:
    overlay = tmp_path / "emulated.yaml"
    overlay.write_text(EMULATED)
    watched = ["fuse_image", "fuse_image_lower", "fuse_cloud"]
    made = fly("uav", tiny_flight, tmp_path, watched, overlays=[overlay])
    images: list[FusedImage] = [m.payload for name in watched[:2] for m in made[name]]
    assert [image.camera for image in images] == 5 * ["rgb"] + 5 * ["rgb_lower"]
    for fused in made["fuse_cloud"]:
        cloud: Cloud = fused.payload
        assert cloud.voted is not None
        shares = [(cloud.voted >> bit & 1).mean() for bit in range(3)]  # LiDAR, upper, lower
        assert shares[0] > 0.3
        assert 0.02 < shares[1] < 0.3
        assert 0.02 < shares[2] < 0.3
