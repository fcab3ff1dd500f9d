from __future__ import annotations

from pathlib import Path

import pytest

from accelerators.registry import Registry
from pipeline.graph.graph import Graph, load_graph
from tools.profiling.profile_variants import alone, at_rate, on_device, why_not

MS = 1_000_000


@pytest.fixture(scope="module")
def catalog() -> Registry:
    return Registry.open()


@pytest.fixture(scope="module")
def uav(root: Path, catalog: Registry) -> Graph:
    return load_graph(root / "graphs/emulated_uav.yaml", catalog=catalog)


def names(graph: Graph) -> list[str]:
    assert [stage.name for stage in graph.stages] == [n.name for n in graph.topology.stages]
    return [stage.name for stage in graph.stages]


def test_a_stage_alone_keeps_what_feeds_it_and_nothing_else(uav: Graph) -> None:
    assert names(alone(uav, "segment_scan")) == ["lidar", "segment_scan"]
    fused = names(alone(uav, "fuse_cloud"))
    assert set(fused) == {
        *("rgb", "thermal", "lidar", "odometry"),
        *("segment_rgb", "detect_rgb", "detect_thermal", "segment_scan", "fuse_cloud"),
    }


def test_a_stage_alone_takes_every_frame_also_where_it_would_wait_to_be_asked(
    root: Path, catalog: Registry
) -> None:
    graph = load_graph(
        root / "graphs/emulated_uav.yaml",
        catalog=catalog,
        settings=[f"stages.{name}.run=wanted" for name in ("segment_rgb", "detect_rgb")],
    )
    assert graph.topology.stage("segment_rgb").wanted
    assert not alone(graph, "segment_rgb").topology.stage("segment_rgb").wanted


def test_on_a_device_it_has_no_other(uav: Graph) -> None:
    moved = on_device(uav, "segment_rgb", "igpu")
    assert moved.stage("segment_rgb").ladder == ("igpu",)
    assert moved.topology.stage("segment_rgb").devices == ("igpu",)
    assert moved.topology.stage("detect_rgb") == uav.topology.stage("detect_rgb")


def test_at_a_rate_its_trigger_is_decimated_and_nothing_else(uav: Graph) -> None:
    slow = at_rate(uav, "fuse_image", 5.0).topology.stage("fuse_image")
    before = uav.topology.stage("fuse_image")
    assert slow.trigger.period == 200 * MS
    assert [e for e in slow.inputs if e.name != "scores"] == [
        e for e in before.inputs if e.name != "scores"
    ]


def test_a_device_without_a_file_of_the_model_is_told_why(root: Path, catalog: Registry) -> None:
    graph = load_graph(root / "graphs/emulated_uav.yaml", catalog=catalog)
    assert why_not(catalog, graph, graph.stage("segment_rgb"), "igpu") is None
    moved = load_graph(
        root / "graphs/emulated_uav.yaml",
        catalog=catalog,
        settings=["devices.cpu={use: 'accelerators.onnx:Onnx'}"],
    )
    reason = why_not(catalog, moved, moved.stage("segment_rgb"), "cpu")
    assert reason is not None
    assert "no variant" in reason
