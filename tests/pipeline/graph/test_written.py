"""A resolved graph file as one text: it means the same from any folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from accelerators.registry import Registry
from pipeline.graph.graph import Graph, load_graph

OVER = """
parameters: {folder: pictures, rate: 5}
stages:
  pictures:
    use: stages.sources.images:ImageFolder
    options: {path: $folder/left, camera: a$$b, rate_hz: $rate}
  map_file:
    use: stages.sinks.ply:WritePly
    options: {path: $out/map.ply}
    inputs: {map: semantic_map}
"""


def load(path: Path, out: Path, **more: Any) -> Graph:
    return load_graph(path, catalog=Registry.open(), out=out, **more)


def options(graph: Graph) -> list[dict[str, Any]]:
    return [
        {key: value for key, value in stage.options.items() if key != "calibration"}
        for stage in graph.stages
    ]


@pytest.mark.parametrize("name", ["emulated_uav", "emulated_two_cameras"])
def test_a_shipped_graph_reads_the_same_from_its_text(
    root: Path, tmp_path: Path, name: str
) -> None:
    graph = load(root / f"graphs/{name}.yaml", tmp_path)
    assert graph.written is not None
    again = tmp_path / "again.yaml"
    again.write_text(graph.written.text())
    copy = load(again, tmp_path)
    assert copy.topology == graph.topology
    assert options(copy) == options(graph)
    assert copy.devices.keys() == graph.devices.keys()
    assert copy.written is not None
    assert copy.written.text() == graph.written.text()


def test_paths_are_absolute_and_outputs_stay_in_the_output_folder(
    root: Path, tmp_path: Path
) -> None:
    over = tmp_path / "over/over.yaml"
    over.parent.mkdir()
    over.write_text(OVER)
    graph = load(
        root / "graphs/emulated_uav.yaml",
        tmp_path / "out",
        overlays=[over],
        settings=["parameters.rate=7"],
    )
    assert graph.written is not None
    text = yaml.safe_load(graph.written.text())
    left = {"path": str(tmp_path / "over/pictures/left"), "camera": "a$$b", "rate_hz": 7}
    assert text["stages"]["pictures"]["options"] == left
    assert text["stages"]["map_file"]["options"] == {"path": "$out/map.ply"}
    assert not {"include", "parameters"} & text.keys()
