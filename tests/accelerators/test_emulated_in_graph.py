"""An emulated device as a graph file writes it, with the device for its outputs inside."""

from __future__ import annotations

from pathlib import Path

import pytest
from tiny_models import SHAPE, write_onnx

from accelerators.emulated import Emulated
from accelerators.onnx import Onnx
from accelerators.recorded import Record, Recorded
from accelerators.registry import Registry
from pipeline.errors import GraphError
from pipeline.graph.graph import Graph, load_graph

GRAPH = """\
overflight: 1
graph: flight
devices:
  tpu: {use: accelerators.emulated:Emulated, BLOCK}
stages:
  camera: {use: stages.sources.emulated:EmulatedCamera, options: {width: 32, height: 16}}
"""


def read(folder: Path, block: str) -> Graph:
    (folder / "graph.yaml").write_text(GRAPH.replace("BLOCK", block))
    return load_graph(folder / "graph.yaml", catalog=Registry.open())


def test_the_paper_s_latencies_and_a_fault_are_one_line(tmp_path: Path) -> None:
    graph = read(tmp_path, "latencies: paper.edgetpu, faults: {dies_at_s: 3, returns_at_s: 6}")
    device = graph.devices["tpu"].make()
    assert isinstance(device, Emulated)
    assert device.latency_ms["segment-rgb"] == 40.5
    assert device.kinds == ("emulated",)


def test_the_device_that_computes_the_outputs_is_a_block_of_its_own(tmp_path: Path) -> None:
    block = "latency_ms: {a: 1}, outputs: {use: accelerators.onnx:Onnx, threads: 2}"
    device = read(tmp_path, block).devices["tpu"].make()
    assert isinstance(device, Emulated)
    assert isinstance(device.outputs, Onnx)
    assert device.outputs.threads == 2
    assert device.kinds == ("onnx",)


def test_a_path_within_it_is_relative_to_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_onnx(tmp_path / "tiny.onnx")
    record = Record(device=Onnx(), path=tmp_path / "run")
    record.load(str(tmp_path / "tiny.onnx"), {"model": "tiny", "kind": "onnx", "shape": SHAPE})
    monkeypatch.chdir("/")
    block = "latency_ms: {tiny: 1}, outputs: {use: accelerators.recorded:Recorded, path: run}"
    device = read(tmp_path, block).devices["tpu"].make()
    assert isinstance(device, Emulated)
    assert isinstance(device.outputs, Recorded)


@pytest.mark.parametrize(
    ("block", "said"),
    [
        ("outputs: onnx", "4:55: devices.tpu.outputs: is a device of its own; write {use: module:"),
        ("outputs: {threads: 1}", "devices.tpu.outputs: is a device of its own"),
        ("outputs: {use: accelerators.onyx:Onnx}", "did you mean 'accelerators.onnx'"),
        ("outputs: {use: pathlib:Path}", "devices.tpu.outputs.use: pathlib:Path is no accelerator"),
        (
            "outputs: {use: accelerators.onnx:Onnx, threats: 1}",
            "devices.tpu.outputs.threats: accelerators.onnx:Onnx has no option 'threats'; did you",
        ),
        (
            "outputs: {use: accelerators.onnx:Onnx, threads: two}",
            "devices.tpu.outputs.threads: expected a whole number, got 'two'",
        ),
        (
            "outputs: {use: accelerators.onnx:Onnx, threads: 0}",
            "devices.tpu.outputs.threads: threads must be at least 1, not 0",
        ),
        ("faults: {dies_at_s: -3}", "devices.tpu.faults.dies_at_s: "),
        ("faults: {dies_at_s: 3, return_at_s: 6}", "devices.tpu.faults.return_at_s: "),
        ("faults: {returns_at_s: 6}", "devices.tpu.faults: returns_at_s has to follow a dies_at_s"),
        ("latencies: paper", "devices.tpu.latencies: latencies paper is no shipped column; known"),
    ],
)
def test_a_mistake_in_it_is_placed(tmp_path: Path, block: str, said: str) -> None:
    with pytest.raises(GraphError) as caught:
        read(tmp_path, block)
    assert said in str(caught.value)
    assert "graph.yaml:4:" in str(caught.value)
