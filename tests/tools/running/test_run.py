from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.measuring.board import Board

Overflight = Callable[..., Any]

GRAPH = """\
overflight: 1
graph: hello
stages:
  camera: {use: stages.sources.emulated:EmulatedCamera, options: {width: 32, height: 16}}
  signal: {use: my_signal:Signal, inputs: {image: camera}}
"""
SIGNAL = """\
import signal
from pipeline.message import Message
from pipeline.stage import Stage
from stages.types import Image

class Signal(Stage):
    def __init__(self, *, number: int = 0, fail: bool = False) -> None:
        self.number, self.fail = number, fail

    def process(self, image: Message[Image]) -> None:
        if self.number and image.seq == 3:
            signal.getsignal(self.number)(self.number, None)  # what Python calls for it
        if self.fail:
            raise ArithmeticError("this one fails")
"""


@pytest.fixture
def hello(tmp_path: Path, overflight: Overflight, monkeypatch: pytest.MonkeyPatch) -> Overflight:
    """Run a small graph, watched in a folder of this test alone."""
    (tmp_path / "hello.yaml").write_text(GRAPH)
    (tmp_path / "my_signal.py").write_text(SIGNAL)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return lambda *words: overflight("run", "hello.yaml", "--speed", "max", *words)


@pytest.mark.parametrize(("number", "name"), [(2, "SIGINT"), (15, "SIGTERM")])
def test_a_run_that_a_signal_ends_says_so(hello: Overflight, number: int, name: str) -> None:
    answer = hello("--set", f"stages.signal.options.number={number}", "--json")
    report = json.loads(answer.out)
    assert answer.code == 0
    assert report["ended"] == f"signal {name}"
    [event] = [event for event in report["events"] if event["kind"] == "stopped"]
    assert event["text"].startswith(f"by {name}")
    assert 0.1 <= event["at_s"] < 1.0  # of the graph's clock: the fourth image
    assert report["ledger_balanced"]


def test_a_run_says_that_its_duration_was_over_or_its_sources_ended(hello: Overflight) -> None:
    for words, ended in (
        (("--duration", "0.3"), "duration"),
        (("--set", "stages.camera.options.count=3"), "sources ended"),
    ):
        report = json.loads(hello(*words, "--json").out)
        assert report["ended"] == ended
        assert [event for event in report["events"] if event["kind"] == "stopped"] == []


def test_a_trace_is_written_and_says_what_was_overwritten(hello: Overflight) -> None:
    words = ("--duration", "0.5", "--trace", "deep/trace.json")
    assert "deep/trace.json has" in hello(*words).out
    answer = hello(*words, "--trace-entries", "20")
    assert "has 20 entries;" in answer.out
    assert "older ones were overwritten (--trace-entries). Open it at ui.perfetto" in answer.out
    assert json.loads(Path("deep/trace.json").read_text())["otherData"]["overwritten"] > 0


def test_a_full_disk_takes_the_trace_or_the_report_and_not_the_table(hello: Overflight) -> None:
    for option, what in (("--trace", "trace"), ("--report", "report")):
        answer = hello("--duration", "0.5", option, "/dev/full")
        assert answer.code == 1
        assert "Every message is accounted for" in answer.out
        assert f"/dev/full: the {what} was not written: No space left on device" in answer.err
        assert "Traceback" not in answer.err


def test_a_run_that_fails_leaves_its_trace_with_the_failure(hello: Overflight) -> None:
    words = ("--set", "stages.signal.options.fail=true", "--duration", "0.5", "--trace", "t.json")
    assert hello(*words).code == 1
    events = json.loads(Path("t.json").read_text())["traceEvents"]
    told = [event for event in events if event["name"] == "failure signal"]
    assert "this one fails" in told[0]["args"]["text"]


def test_a_trace_that_cannot_be_written_is_told_before_the_run(hello: Overflight) -> None:
    answer = hello("--trace", "hello.yaml/trace.json")
    assert answer.code == 2
    assert "no place for the trace" in answer.err


def test_a_run_that_cannot_be_watched_runs_all_the_same(hello: Overflight, tmp_path: Path) -> None:
    (tmp_path / "overflight").touch()
    answer = hello("--duration", "0.1", "--quiet")
    assert answer.code == 0
    assert "`overflight top` will not see this run" in answer.err


def test_a_run_leaves_no_board(hello: Overflight, tmp_path: Path) -> None:
    hello("--duration", "0.1", "--quiet")
    assert [path.name for path in (tmp_path / "overflight").iterdir()] == []
    with Board():
        pass
