"""The command `overflight check`, and `run` on a graph that expects something."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

GRAPH = """\
overflight: 1
graph: poses
parameters: {recording: %s}
stages:
  odometry: {use: stages.sources.emulated:EmulatedOdometry, options: {count: $recording}}
  count:
    use: stages.sinks.count:Count
    inputs: {message: {from: odometry, queue: {policy: block}}}
"""
#: What no run keeps to, whatever comes at once after a thread stood still.
TOO_MUCH = "expect: {outputs: {odometry: {min_rate_hz: 500000}}}\n"
GAPLESS = "expect: {outputs: {odometry: {max_gap_ms: 0.001}}}\n"
WELL = "expect: {inputs: {count/message: {max_drop_percent: 0}}}\n"


@pytest.fixture
def graph(tmp_path: Path) -> Callable[[str], Path]:
    def write(expect: str) -> Path:
        file = tmp_path / "graph.yaml"
        file.write_text(GRAPH % 20 + expect)
        return file

    return write


def test_a_graph_that_keeps_to_its_word_is_well(
    overflight: Callable[..., Any], graph: Callable[[str], Path]
) -> None:
    answer = overflight("check", graph(WELL))
    assert answer.code == 0, answer.err
    assert "met" in answer.out


def test_one_that_does_not_ends_with_code_1_and_a_table(
    overflight: Callable[..., Any], graph: Callable[[str], Path]
) -> None:
    answer = overflight("check", graph(TOO_MUCH))
    assert answer.code == 1
    assert "not met" in answer.out
    assert ">= 500000 Hz" in answer.out


def test_a_program_gets_every_expectation_with_what_was_found(
    overflight: Callable[..., Any], graph: Callable[[str], Path]
) -> None:
    answer = overflight("check", graph(TOO_MUCH), "--json")
    assert answer.code == 1
    page = json.loads(answer.out)
    assert not page["well"]
    (found,) = page["expectations"]
    assert (found["of"], found["key"], found["met"]) == ("odometry/out", "min_rate_hz", False)
    assert 0 < found["found"] < 500_000


def test_offline_a_rate_is_not_judged(
    overflight: Callable[..., Any], graph: Callable[[str], Path]
) -> None:
    answer = overflight("check", graph(TOO_MUCH), "--speed", "max")
    assert answer.code == 0, answer.err
    assert "not judged offline" in answer.out


@pytest.mark.parametrize("on", ["3", "recording=3"])
def test_on_sets_the_recording(
    overflight: Callable[..., Any], graph: Callable[[str], Path], on: str
) -> None:
    answer = overflight("check", graph(GAPLESS), "--on", on, "--json")
    assert answer.code == 1
    answer = overflight("check", graph(GAPLESS), "--on", "flight=3")
    assert answer.code == 2
    assert "the graph has no parameter 'flight'" in answer.err


def test_a_file_that_expects_nothing_cannot_be_checked(
    overflight: Callable[..., Any], graph: Callable[[str], Path]
) -> None:
    answer = overflight("check", graph(""))
    assert answer.code == 2
    assert "has no 'expect' block" in " ".join(answer.err.replace("│", " ").split())


def test_a_run_fails_by_what_its_file_expects(
    overflight: Callable[..., Any], graph: Callable[[str], Path]
) -> None:
    answer = overflight("run", graph(TOO_MUCH), "--report", "report.json")
    assert answer.code == 1
    assert "expected at least 500000 Hz" in answer.err
    (found,) = json.loads(Path("report.json").read_text())["expectations"]
    assert found["met"] is False
    assert overflight("run", graph(WELL), "--quiet").code == 0
