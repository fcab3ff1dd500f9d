"""Ouster recordings through a whole graph: range image, segmentation, fusion and map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.drivers.run import run_graph
from tools.load import open_graph

#: Stands for a trained network: what lies low is road, what lies high is building. It undoes the
#: normalization, so that a wrong channel, row or statistic changes the answer.
NETWORK = """\
import numpy as np
from pipeline.model import Probe, TensorSpec
from stages.scan_statistics import SHIPPED, ScanStatistics

class ByHeight:
    '''Labels cells by their height.'''
    kinds = ("emulated",)
    inputs = {"range_image": TensorSpec((1, 64, 512, 5), "float32")}
    outputs = {"scores": TensorSpec((1, 64, 512, 16), "float32")}
    def probe(self): return Probe(True, "by height", "NumPy")
    def load(self, path, variant): return self
    def close(self): pass
    def infer(self, inputs):
        own = ScanStatistics.read(SHIPPED, "os0_128")
        z = inputs["range_image"][0, ..., 3] * own.std[3] + own.mean[3]
        scores = np.zeros((1, 64, 512, 16), np.float32)
        scores[0, ..., 3], scores[0, ..., 1] = 5 * (z < -1), 5 * (z > 1)
        return {"scores": scores}
"""
GRAPH = """\
overflight: 1
graph: ouster
parameters: {recording: "", poses: null, back: cell}
calibration: {use: stages.sources.ouster:calibration, options: {path: $recording}}
devices:
  net: {use: by_height:ByHeight}
stages:
  lidar:    {use: stages.sources.ouster:OusterScans, options: {path: $recording}}
  odometry: {use: stages.sources.ouster:OusterPoses, options: {path: $recording, poses: $poses}}
  segment_scan:
    use: stages.segment_scan:SegmentScan
    executor: [net]
    model: segment-scan
    options: {back: $back}
    inputs: {scan: lidar}
  fuse_cloud:
    use: stages.fuse_cloud:FuseCloud
    inputs: {cloud: segment_scan, trajectory: {from: odometry, sync: span}}
  semantic_map:
    use: stages.semantic_map:SemanticMap
    inputs: {cloud: {from: fuse_cloud, queue: {policy: block, size: 2}}}
  map_file:
    use: stages.sinks.npz:WriteNpz
    options: {folder: $out/map}
    inputs: {message: semantic_map}
"""
OS0, OS1 = "OS-0-128-U1_v2.3.0_1024x10.pcap", "OS-1-128_v2.3.0_1024x10_lb_n3"


@pytest.fixture
def map_of(tmp_path: Path, shared: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Runs the graph on a recording: its report, and the arrays of the map."""
    pytest.importorskip("ouster.sdk", reason="needs the Ouster SDK: the extra 'ouster'")
    (tmp_path / "by_height.py").write_text(NETWORK)
    (tmp_path / "ouster.yaml").write_text(GRAPH)
    monkeypatch.syspath_prepend(tmp_path)

    def run(recording: Path | str, **parameters: Path | str) -> tuple[Any, Any]:
        parameters["recording"] = shared / "data" / "ouster" / recording
        settings = [f"parameters.{name}={value}" for name, value in parameters.items()]
        graph, catalog = open_graph(tmp_path / "ouster.yaml", settings, out=tmp_path)
        result = run_graph(graph, catalog, speed=None)
        assert result.failures == ()
        assert result.report["ledger_balanced"]
        return result.report["stages"], dict(np.load(max((tmp_path / "map").iterdir())))

    return run


@pytest.mark.slow
@pytest.mark.parametrize("back", ["cell", "neighbors"])
def test_the_paper_s_lidar_becomes_a_map(map_of: Any, back: str) -> None:
    stages, found = map_of(OS0, back=back)
    counted = stages["fuse_cloud"]["statistics"]
    assert counted["points_with_evidence"] / counted["points"] > 0.9
    assert counted["sweeps_not_deskewed"] == counted["stamps_without_pose"] == 0
    label, z = found["log_scores"][:, :15].argmax(axis=1), found["positions"][:, 2]
    assert len(z) > 10_000
    assert (label[z < -1.5] == 3).mean() > 0.95
    assert (label[z > 1.5] == 1).mean() > 0.95


@pytest.mark.slow
def test_poses_sharpen_the_map(map_of: Any, shared: Path) -> None:
    poses = shared / "data" / "ouster" / f"{OS1}_poses_kitti.txt"
    stages, moved = map_of(f"{OS1}.pcap", poses=poses)
    assert stages["semantic_map"]["statistics"]["clouds"] == 3
    assert stages["fuse_cloud"]["statistics"]["sweeps_not_deskewed"] == 0
    _, still = map_of(f"{OS1}.osf")
    assert len(moved["positions"]) < 0.97 * len(still["positions"])


@pytest.mark.slow
def test_columns_that_were_lost_cost_only_their_points(
    map_of: Any, shared: Path, tmp_path: Path
) -> None:
    content = (shared / "data" / "ouster" / f"{OS1}.pcap").read_bytes()
    metadata = shared / "data" / "ouster" / "OS-1-128_v2.3.0_1024x10.json"
    (tmp_path / "cut.pcap").write_bytes(content[: len(content) // 2])
    (tmp_path / "cut.json").write_bytes(metadata.read_bytes())
    stages, found = map_of(tmp_path / "cut.pcap")
    assert stages["lidar"]["statistics"]["columns_missing"] == 528
    assert stages["semantic_map"]["statistics"]["clouds"] == 2
    assert np.isfinite(found["positions"]).all()
    assert not (np.linalg.norm(found["positions"], axis=1) < 0.5).any()  # no return is no point
