from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Overflight = Callable[..., Any]

GRAPH = """\
overflight: 1
graph: look
devices:
  igpu: {use: accelerators.openvino:OpenVino, device: GPU.7}
  cpu: {use: accelerators.onnx:Onnx}
  spare: {use: accelerators.emulated:Emulated, latency_ms: {tiny: 0}}
stages:
  camera: {use: stages.sources.emulated:EmulatedCamera, options: {width: 32, height: 16}}
  look: {use: my_look:Look, model: tiny, executor: [cpu], inputs: {image: camera}}
"""
LOOK = """\
from pipeline.message import Message
from pipeline.model import Tensors
from pipeline.stage import ModelStage
from stages.types import Image

class Look(ModelStage):
    '''Looks at an image.'''

    def prepare(self, image: Message[Image]) -> Tensors:
        return {}

    def finish(self, outputs: Tensors, image: Message[Image]) -> int:
        return 1
"""
MODELS = """\
models:
  tiny:
    description: relu
    license: Apache-2.0
    source: the tests
    input: {name: x, shape: [2, 3, 3], dtype: float32}
    head: {kind: none}
    variants:
      - {kind: onnx, file: tiny.onnx, sha256: SUM, outputs: {y: {}}}
"""


#: y1 = relu(x) of (1, 2, 3, 3) float32 as an .onnx file.
TINY_ONNX = (
    "08083a500a0d0a017812027931220452656c75120474696e795a1b0a017812160a14080112100a0208010a02"
    "08020a0208030a020803621c0a02793112160a14080112100a0208010a0208020a0208030a02080342040a00"
    "100d"
)


@pytest.fixture
def examine(overflight: Overflight, tmp_path: Path) -> Overflight:
    """Run the doctor on the graph, with all files in place, in text or as JSON."""
    (tmp_path / "tiny.onnx").write_bytes(bytes.fromhex(TINY_ONNX))
    total = hashlib.sha256((tmp_path / "tiny.onnx").read_bytes()).hexdigest()
    (tmp_path / "graph.yaml").write_text(GRAPH)
    (tmp_path / "my_look.py").write_text(LOOK)
    (tmp_path / "models.yaml").write_text(MODELS.replace("SUM", total))

    def run(*words: str) -> Any:
        return overflight("doctor", "graph.yaml", "--models", "models.yaml", *words)

    return run


def test_a_graph_that_has_all_it_names_is_well(examine: Overflight) -> None:
    answer = examine()
    assert answer.code == 0, answer.out
    assert "ready    tiny on cpu" in answer.out
    assert "graph.yaml: everything that it names is here" in answer.out


def test_a_device_that_no_stage_uses_may_be_missing(examine: Overflight) -> None:
    found = json.loads(examine("--json").out)
    assert found["ready"]
    states = {one["name"]: (one["used"], one["ready"]) for one in found["devices"]}
    assert states == {"igpu": (False, False), "cpu": (True, True), "spare": (False, True)}


def test_a_rung_that_is_missing_is_named_with_the_way_out(examine: Overflight) -> None:
    answer = examine("--set", "stages.look.executor=[igpu, cpu]")
    assert answer.code == 1
    assert "missing  igpu\n           OpenVINO finds no device GPU.7, only " in answer.out
    assert "missing  tiny on igpu, the device is missing\n           tiny.onnx\n" in answer.out
    assert "look: cpu (not igpu)" in answer.out
    assert answer.out.endswith("something is missing; it runs, on lower rungs\n")


def test_a_ladder_without_a_rung_cannot_run(examine: Overflight) -> None:
    words = ("--set", "devices.cpu={use: accelerators.onnx:Onnx, provider: CUDA}")
    answer = examine(*words)
    assert answer.code == 1
    assert "look: cannot run, on none of cpu" in answer.out
    assert answer.out.endswith("something is missing; it cannot run here\n")
    found = json.loads(examine(*words, "--json").out)
    assert found["ladders"] == [{"stage": "look", "rungs": ["cpu"], "ready": []}]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda file: file.unlink(), "no file tiny.onnx in "),
        (lambda file: file.write_bytes(file.read_bytes() + b"x"), "the registry says"),
    ],
    ids=["missing", "changed"],
)
def test_a_model_file_that_is_not_right_is_a_finding_and_not_a_mistake_of_the_graph(
    examine: Overflight, tmp_path: Path, damage: Callable[[Path], Any], said: str
) -> None:
    damage(tmp_path / "tiny.onnx")
    answer = examine()
    assert answer.code == 1
    assert said in answer.out
    assert "it does not start before its model files are right" in answer.out


def test_a_mistake_in_the_file_is_answered_as_by_validate(examine: Overflight) -> None:
    answer = examine("--set", "stages.look.executor=[cup]")
    assert answer.code == 2
    assert "did you mean 'cpu'" in answer.err


def test_a_model_is_timed_where_it_runs(examine: Overflight) -> None:
    (model,) = json.loads(examine("--json").out)["models"]
    assert (model["model"], model["device"], model["ready"]) == ("tiny", "cpu", True)
    assert model["what"] == "tiny.onnx"
    assert model["infer_ms"] >= 0


def test_more_threads_than_cores_are_hinted_at(examine: Overflight) -> None:
    many = len(os.sched_getaffinity(0)) + 1
    answer = examine("--set", f"devices.cpu.threads={many}")
    assert f"ask for {many} threads (cpu {many})" in answer.out
    assert "threads" not in examine().out
