from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from accelerators.registry import Registry
from pipeline.graph.graph import Graph, load_graph
from pipeline.processes.endpoints import ends_of, host_of_clock

GRAPH = """\
overflight: 1
graph: apart
hosts:
  drone: {listen: ["tcp/10.0.0.2:7447"], reach: ["tcp/drone.local:9000"], zenoh: {mode: peer}}
  ground: {}
processes:
  main: {host: drone}
  mapping: {host: drone}
  station: {host: ground}
stages:
  rgb: {use: stages.sources.emulated:EmulatedCamera}
  far: {use: stages.sources.emulated:EmulatedCamera, process: mapping}
  near: {use: stages.sinks.count:Count, process: mapping, inputs: {message: rgb}}
  a: {use: stages.sinks.count:Count, process: station, inputs: {message: rgb}}
  b: {use: stages.sinks.count:Count, process: station, inputs: {message: far}}
"""
HERE = {"main": "tcp/127.0.0.1:1", "mapping": "tcp/127.0.0.1:2"}


@pytest.fixture
def graph(tmp_path: Path) -> Graph:
    file = tmp_path / "apart.yaml"
    file.write_text(GRAPH)
    return load_graph(file, catalog=Registry.open())


def ends(graph: Graph, name: str) -> dict[str, Any]:
    here = {"station": "tcp/127.0.0.1:3"} if name == "station" else HERE
    return ends_of(graph, name, list(here), here)


def test_of_two_processes_of_a_host_the_later_looks_for_the_earlier(graph: Graph) -> None:
    assert ends(graph, "main")["connect"] == []
    assert ends(graph, "mapping")["connect"] == ["tcp/127.0.0.1:1"]


def test_each_process_that_meets_another_host_takes_the_next_port(graph: Graph) -> None:
    assert ends(graph, "main")["listen"] == ["tcp/127.0.0.1:1", "tcp/10.0.0.2:7447"]
    assert ends(graph, "mapping")["listen"] == ["tcp/127.0.0.1:2", "tcp/10.0.0.2:7448"]
    assert ends(graph, "station")["listen"] == ["tcp/127.0.0.1:3"]  # open to no other host
    looked_for = ["tcp/drone.local:9000", "tcp/drone.local:9001"]
    assert ends(graph, "station")["connect"] == looked_for


def test_the_host_of_the_first_source_tells_the_clock(graph: Graph) -> None:
    assert host_of_clock(graph) == "drone"
    assert ends(graph, "main")["tells_clock"]
    assert not ends(graph, "station")["tells_clock"]
    assert ends(graph, "station")["follows"] == "main"
    assert ends(graph, "mapping")["follows"] is None


def test_zenohs_own_keys_go_to_every_process_of_the_host(graph: Graph) -> None:
    assert ends(graph, "mapping")["zenoh"].items() >= {"mode": "peer"}.items()
    assert "mode" not in ends(graph, "station")["zenoh"]
