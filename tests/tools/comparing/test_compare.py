from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tiny_models import write_onnx, write_tflite

Overflight = Callable[..., Any]

GRAPH = """\
overflight: 1
graph: swap
devices:
  cpu: {use: accelerators.litert:TfliteCpu}
  ort: {use: accelerators.onnx:Onnx}
stages:
  camera: {use: stages.sources.emulated:EmulatedCamera, options: {width: 12, height: 8}}
  segment:
    use: stages.segment_image:SegmentImage
    executor: cpu
    model: tiny
    inputs: {image: camera}
  mark: {use: my_stages:Mark, inputs: {scores: segment}}
  interrupt: {use: my_stages:Interrupt, inputs: {image: camera}}
"""
STAGES = """\
import signal
from pipeline.message import Message
from pipeline.stage import Stage
from stages.types import ClassScores, Image

class Mark(Stage):
    def process(self, scores: Message[ClassScores]) -> int:
        return 1

class Interrupt(Stage):
    def __init__(self, *, at: int = -1) -> None:
        self.at, self.count = at, 0

    def process(self, image: Message[Image]) -> None:
        self.count += 1
        if self.count == self.at:
            signal.getsignal(signal.SIGINT)(signal.SIGINT, None)
"""
REGISTRY = """\
models:
  tiny:
    description: relu
    license: Apache-2.0
    source: the tests
    input: {shape: [2, 3, 3], dtype: uint8, color: rgb}
    head: {kind: scores, class_map: {0: road, 1: building, 2: vehicle}}
    variants:
      - {kind: tflite, file: tiny.tflite, outputs: {scores: {}}}
      - {kind: onnx, file: tiny.onnx, std: [1], outputs: {scores: {}}}
"""


@pytest.fixture
def compare(tmp_path: Path, overflight: Overflight) -> Overflight:
    """Compare over 0.3 s of the graph."""
    (tmp_path / "swap.yaml").write_text(GRAPH)
    (tmp_path / "my_stages.py").write_text(STAGES)
    (tmp_path / "models.yaml").write_text(REGISTRY)
    write_tflite(tmp_path / "tiny.tflite")
    write_onnx(tmp_path / "tiny.onnx")

    def run(*words: str) -> Any:
        common = ("--models", "models.yaml", "--duration", "0.3")
        return overflight("compare", "swap.yaml", *common, *words)

    return run


SWAP = ("--b", "stages.segment.executor=ort")


def test_the_same_network_on_two_runtimes_agrees_and_each_side_says_what_it_cost(
    compare: Overflight,
) -> None:
    answer = compare(*SWAP, "--json", "--report", "new/swap.json")
    assert answer.code == 0, answer.err
    page = json.loads(answer.out)
    assert page == json.loads(Path("new/swap.json").read_text())
    assert list(page["agreement"]) == ["segment/out"]
    found = page["agreement"]["segment/out"]
    assert found["messages"] == 9
    assert found["messages_only_a"] == found["messages_only_b"] == 0
    assert found["same_label"] == found["mean_iou"] == 1.0
    for side, device in (("a", "cpu"), ("b", "ort")):
        cost = page[side]["stages"]["segment"]
        assert (cost["model"], cost["device"], cost["runs"]) == ("tiny", device, 9)
        assert set(cost["cpu_ms"]) == {"prepare", "infer", "finish"}
        assert 0 < cost["device_ms"]["p50"] <= cost["device_ms"]["p99"]
        parts = cost["cpu_ms"]["prepare"] + cost["device_ms"]["p50"] + cost["cpu_ms"]["finish"]
        assert cost["latency_ms"] == pytest.approx(parts, abs=1e-3)
    assert page["not_compared"] == ["mark/out"]


def test_a_file_that_computes_something_else_does_not_agree(
    compare: Overflight, tmp_path: Path
) -> None:
    registry = tmp_path / "models.yaml"
    registry.write_text(REGISTRY.replace("std: [1]", "mean: [0, 255, 0]"))
    found = json.loads(compare(*SWAP, "--json").out)["agreement"]["segment/out"]
    assert found["same_label"] < 1.0


def test_the_tables_tell_a_person_the_same(compare: Overflight) -> None:
    answer = compare(*SWAP)
    assert "a: the file as it is" in answer.out
    assert "b: stages.segment.executor=ort" in answer.out
    assert "segment: 9 messages of each; same label on 100.00 % of 54 pixels" in answer.out
    assert "Not compared, of payloads without a measure: mark/out" in answer.out
    assert compare(*SWAP, "--quiet").out == ""


def test_an_option_of_the_stage_is_a_difference_too(compare: Overflight) -> None:
    setting = "stages.segment.options.temperature=9"
    found = json.loads(compare("--b", setting, "--json").out)["agreement"]["segment/out"]
    assert found["same_label"] == 1.0
    assert found["confidence_difference"] > 0


def test_an_option_of_the_device_is_a_difference_too(compare: Overflight) -> None:
    page = json.loads(compare("--b", "devices.cpu.threads=2", "--json").out)
    assert list(page["agreement"]) == ["segment/out"]


def test_sides_that_do_not_differ_are_a_mistake(compare: Overflight) -> None:
    for words in ((), ("--a", "stages.segment.executor=[cpu]"), ("--b", "devices.ort.threads=2")):
        answer = compare(*words)
        assert answer.code == 2
        assert answer.err == (
            "swap.yaml: a and b differ in nothing that can be compared; say what differs, as "
            "--b stages.segment_rgb.executor=cpu\n"
        )


def test_a_mistake_in_a_side_is_told_as_validate_tells_it(compare: Overflight) -> None:
    answer = compare("--b", "stages.segment.executor=cup")
    assert answer.code == 2
    assert "no device 'cup'; did you mean 'cpu'?" in answer.err


def test_ctrl_c_ends_it_without_a_result(compare: Overflight) -> None:
    answer = compare(*SWAP, "--set", "stages.interrupt.options.at=4", "--json")
    assert answer.code == 130
    assert answer.out == ""


@pytest.mark.slow
def test_public_networks_on_a_real_drive_agree_as_far_as_their_number_formats_do(
    shared: Path, root: Path, overflight: Overflight
) -> None:
    common = [
        f"parameters.recording={shared / 'data' / 'kitti_drive_full6'}",
        "stages.detect_rgb.model=detect-rgb-fastestdet",
        "stages.segment_rgb.options.tiles=[]",
    ]
    words = [word for setting in common for word in ("--set", setting)]
    words += ["--duration", "0.15", "--json"]  # two frames

    def boxes(a: str, b: str) -> Any:
        sides = [f"stages.detect_rgb.executor={device}" for device in (a, b)]
        answer = overflight(
            *("compare", root / "graphs" / "drive.yaml", *words),
            *("--a", sides[0], "--b", sides[1]),
        )
        assert answer.code == 0, answer.err
        page = json.loads(answer.out)
        assert set(page["agreement"]) == {"detect_rgb/out", "fuse_cloud/out", "semantic_map/out"}
        assert page["agreement"]["fuse_cloud/out"]["same_label"] > 0.98
        return page["agreement"]["detect_rgb/out"]

    same = boxes("ov", "onnx")  # the same f32 file
    assert same["count_a"] == same["count_b"] == same["matched"] > 5
    assert same["mean_iou"] > 0.999
    assert same["largest_score_difference"] < 0.001
    eight_bit = boxes("cpu", "ov")
    assert 0.6 * eight_bit["count_a"] < eight_bit["matched"] < eight_bit["count_a"]
    assert 0.7 < eight_bit["mean_iou"] < 0.95
