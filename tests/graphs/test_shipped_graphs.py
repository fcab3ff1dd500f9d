"""Every graph file that ships loads and runs, and the picture in the README is the graph's."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
import yaml
from driving import arrive

from pipeline.drivers.run import RunResult, run_graph
from pipeline.drivers.snapshot import Snapshot
from pipeline.graph.spec import graph_schema
from tools.drawing.diagram import Diagram
from tools.drawing.svg import svg
from tools.load import open_graph

GRAPHS = Path(__file__).resolve().parents[2] / "graphs"
EMULATED = GRAPHS / "emulated_uav.yaml"

#: Graphs that need a recording, and the folder of ../shared/data that they are tested with.
RECORDED = {
    "drive.yaml": "kitti_drive_lite108",
    "label_propagation_drive.yaml": "kitti_drive_lite108",
}

#: What a test leaves out of a graph that has more time than it.
SHORTER = {
    "label_propagation_drive.yaml": [
        "stages.segment_rgb.options.tiles=[{aspect: 1.0, count: 1}]",
        "stages.segment_rgb.options.gammas=[1.0]",
    ]
}

#: Graphs that need a flight; a simulated one is made for them.
FLOWN = (
    "uav.yaml",
    "uav_truth.yaml",
    "uav_edgetpu_igpu.yaml",
    "judge_networks.yaml",
    "label_propagation.yaml",
    "label_propagation_truth.yaml",
)

#: Graphs on devices that a machine for tests does not have: they are loaded, not run.
ON_HARDWARE = ("uav_edgetpu_igpu.yaml",)


def settings(name: str, request: pytest.FixtureRequest) -> list[str]:
    """What a graph needs to run here; skips where that is absent."""
    if name in FLOWN:
        missing = sorted(named_models(GRAPHS / "uav/networks.yaml") - trained_models())
        if name != "uav_truth.yaml" and missing:
            pytest.skip(f"no weights yet of {', '.join(missing)}")
        flight = f"parameters.flight={request.getfixturevalue('tiny_flight')}"
        return [flight, *(["parameters.rate_hz=10"] if name == "judge_networks.yaml" else [])]
    if name not in RECORDED:
        return []
    shared: Path = request.getfixturevalue("shared")
    recording = f"parameters.recording={shared / 'data' / RECORDED[name]}"
    return [recording, *SHORTER.get(name, [])]


def named_models(path: Path) -> set[str]:
    stages = yaml.safe_load(path.read_text())["stages"].values()
    return {stage["model"] for stage in stages}


def trained_models() -> set[str]:
    """The models of the registry that have a file for a runtime of this machine's CPU."""
    models = yaml.safe_load((GRAPHS / "models/models.yaml").read_text())["models"]
    cpu = {"tflite", "openvino", "onnx"}
    return {
        name
        for name, entry in models.items()
        if any(variant["kind"] in cpu for variant in entry["variants"])
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(path.name for path in GRAPHS.glob("*.yaml")))
def test_a_shipped_graph_loads_and_runs_offline(
    name: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    graph, catalog = open_graph(GRAPHS / name, settings(name, request), out=tmp_path)
    if name in ON_HARDWARE:
        return
    result = run_graph(graph, catalog, speed=None, duration_s=1.0)
    assert result.failures == ()
    assert_all_ran(result)


@pytest.mark.slow
@pytest.mark.realtime
def test_the_demo_runs_live(tmp_path: Path) -> None:
    def stop_once_all_ran(snapshot: Snapshot) -> None:
        if all(output.count for output in snapshot.outputs.values()):
            arrive(signal.SIGINT)

    graph, catalog = open_graph(EMULATED, out=tmp_path)
    result = run_graph(graph, catalog, duration_s=60.0, progress=stop_once_all_ran)
    assert result.failures == ()
    assert_all_ran(result)


def assert_all_ran(result: RunResult) -> None:
    assert result.report["ledger_balanced"]
    idle = [name for name, output in result.report["outputs"].items() if not output["count"]]
    assert not idle


def test_the_picture_is_that_of_the_graph() -> None:
    graph, _ = open_graph(EMULATED)
    drawn = svg(Diagram.of(graph)) + "\n"
    assert EMULATED.with_suffix(".svg").read_text() == drawn, (
        "draw it again: overflight graph graphs/emulated_uav.yaml -o graphs/emulated_uav.svg"
    )


def test_the_schema_beside_the_graphs_is_the_one_that_the_code_gives() -> None:
    assert json.loads((GRAPHS / "graph.schema.json").read_text()) == graph_schema()


@pytest.mark.parametrize("path", sorted(GRAPHS.glob("*.yaml")), ids=lambda path: path.name)
def test_a_shipped_graph_names_its_schema_for_editors(path: Path) -> None:
    first = path.read_text().splitlines()[0]
    assert first == "# yaml-language-server: $schema=./graph.schema.json"
