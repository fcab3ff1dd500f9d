"""The shipped overlays that make sensors, processes and links fail."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.drivers.run import run_graph
from tools.load import open_graph

BASES = {
    "sensors_fail.yaml": "emulated_uav.yaml",
    "process_killed.yaml": "uav_two_process.yaml",
    "link_cut.yaml": "uav_two_process.yaml",
    "link_slow.yaml": "uav_two_process.yaml",
}


@pytest.mark.parametrize("overlay", BASES)
def test_an_overlay_fits_the_graph_that_it_names(root: Path, overlay: str) -> None:
    path = root / "graphs/faults" / overlay
    assert f"Over graphs/{BASES[overlay]}:" in path.read_text()
    graph, _ = open_graph(root / "graphs" / BASES[overlay], overlays=[path])
    faults = graph.faults
    assert faults.sources or faults.kills or faults.links
    assert graph.warnings == open_graph(root / "graphs" / BASES[overlay])[0].warnings


@pytest.mark.slow
def test_the_fused_outputs_go_on_without_the_sensors_that_fail(root: Path) -> None:
    times = {
        "thermal.dies_at_s": 0.3,
        "thermal.returns_at_s": 0.7,
        "lidar.stalls_at_s": 0.8,
        "lidar.stalls_for_s": 0.2,
        "odometry.repeats_at_s": 0.5,
        "rgb.jumps_at_s": 1.0,
        "rgb.jumps_by_ms": -100,
    }
    graph, catalog = open_graph(
        root / "graphs/emulated_uav.yaml",
        [f"faults.sources.{key}={value}" for key, value in times.items()],
        [root / "graphs/faults/sensors_fail.yaml"],
    )
    report = run_graph(graph, catalog, speed=None, duration_s=1.5).report
    told = {event["of"] for event in report["events"] if event["kind"] == "fault"}
    assert told == {"thermal", "lidar", "odometry", "rgb"}
    assert report["refused"]["odometry/out"] == {"backward": 1}
    assert 2 <= report["refused"]["rgb/out"]["backward"] <= 4  # 100 ms at 30 Hz
    assert report["failures"] == []
    assert report["ledger_balanced"]
    assert report["outputs"]["fuse_cloud/out"]["count"] >= 10
    assert report["outputs"]["thermal/out"]["count"] < report["outputs"]["rgb/out"]["count"] - 8


def test_in_one_process_faults_between_processes_are_left_out_and_told(root: Path) -> None:
    graph, catalog = open_graph(
        root / "graphs/uav_two_process.yaml",
        ["stages.map_file=null"],
        [root / "graphs/faults/link_cut.yaml"],
    )
    report = run_graph(graph, catalog, speed=None, duration_s=0.1).report
    [event] = [event for event in report["events"] if event["kind"] == "fault"]
    assert event["of"] == "fuse_cloud/out"
    assert event["text"] == "left out: all stages share one process here"
