"""Real processes, killed for real: what `overflight run` does with a graph of several."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from flying import TWO_PROCESSES, Run, shared_memory

from pipeline.recording.mcap import McapReader
from pipeline.recording.recorder import DECISIONS

pytestmark = [pytest.mark.slow, pytest.mark.realtime]


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Callable[..., Run]]:
    started: list[Run] = []

    (tmp_path / "apart.yaml").write_text(TWO_PROCESSES)

    def start(*words: str) -> Run:
        started.append(Run(tmp_path, *words))
        return started[-1]

    yield start
    for each in started:
        each.close()


def flows(page: dict[str, Any]) -> bool:
    return bool(page["outputs"].get("work/out", {}).get("count", 0) >= 5)


def test_the_processes_of_a_graph_end_with_its_sources_and_one_report_and_replay_as_recorded(
    run: Callable[..., Run],
    overflight: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    counts = ["--set", "stages.camera.options.count=40", "--set", "stages.lidar.options.count=20"]
    kept = ("--record", "flight.mcap", "--record-edges", "all", "--trace", "trace.json")
    report = run(*counts, *kept).report()
    assert report["ended"] == "sources ended"
    assert report["ledger_balanced"]
    assert report["outputs"]["work/out"]["count"] == 20
    kept = report["edges"]["work/out->kept/message"]
    assert (kept["produced"], kept["delivered"], kept["dropped"]) == (20, 20, {})
    assert set(report["processes"]) == {"main", "far"}
    assert report["cpu"]["parts_cores"]["transport"] > 0
    assert_traced(json.loads((tmp_path / "trace.json").read_text())["traceEvents"])
    monkeypatch.chdir(tmp_path)
    for name in ("main", "far"):
        answer = overflight("run", f"flight.{name}.mcap", "--as-recorded", "--json")
        replay = json.loads(answer.out)["replay"]
        assert replay["decisions_identical"]
        assert replay["outputs_compared"] >= 60
        assert replay["outputs_different"] == replay["outputs_not_compared"] == 0
        assert replay["options"] == []


def assert_traced(events: list[dict[str, Any]]) -> None:
    """Both processes, and arrows from each to the other."""
    group = {e["pid"]: e["args"]["name"] for e in events if e["name"] == "process_name"}
    assert {"main: threads", "main: stages", "far: threads", "far: stages"} <= set(group.values())
    place = {(e["ph"], e["id"]): group[e["pid"]] for e in events if e["ph"] in "sf"}
    arrows = {(place["s", i], place["f", i]) for phase, i in place if phase == "s"}
    assert {("main: threads", "far: threads"), ("far: threads", "main: threads")} <= arrows


def test_ctrl_c_ends_every_process_and_leaves_nothing(run: Callable[..., Run]) -> None:
    graph = run()
    graph.until(flows)
    os.kill(graph.process.pid, signal.SIGINT)
    report = graph.report()
    graph.assert_no_process_is_left()
    assert report["ended"] == "signal SIGINT"
    assert report["ledger_balanced"]


def test_a_killed_process_is_back_and_its_edges_resume(run: Callable[..., Run]) -> None:
    graph = run()
    graph.until(flows)
    camera = graph.page()["outputs"]["camera/out"]["count"]
    os.kill(graph.pid("far"), signal.SIGKILL)
    graph.until(lambda page: page["processes"]["far"]["restarts"] == 1)
    worked = graph.page()["outputs"]["work/out"]["count"]
    page = graph.until(lambda page: bool(page["outputs"]["work/out"]["count"] > worked + 5))
    assert page["outputs"]["camera/out"]["count"] > camera  # the others went on
    time.sleep(1.0)
    os.kill(graph.process.pid, signal.SIGINT)
    report = graph.report()
    assert report["ledger_balanced"]
    kinds = [event["kind"] for event in report["events"]]
    assert {"process_lost", "process_back", "state_reset"} <= set(kinds)
    assert report["processes"]["far"]["restarts"] == 1
    lost = report["edges"]["camera/out->work/other"]["dropped"]
    assert lost["lost_in_transport"] > 0


def test_a_process_that_may_not_be_started_anew_ends_its_streams_and_fails_the_run(
    run: Callable[..., Run],
) -> None:
    counts = ["--set", "stages.camera.options.count=60", "--set", "processes.far.max_restarts=0"]
    graph = run(*counts)
    graph.until(flows)
    os.kill(graph.pid("far"), signal.SIGKILL)
    report = graph.report(code=1)
    assert report["ended"] == "sources ended"
    [failure] = report["failures"]
    assert failure.startswith("processes.far: its process was killed by SIGKILL")


def test_with_the_supervisor_killed_no_process_stays(run: Callable[..., Run]) -> None:
    graph = run()
    graph.until(flows)
    graph.process.kill()
    graph.process.communicate()
    graph.assert_no_process_is_left()
    run("--duration", "0.2").report()  # the next start removes what that one could not
    assert shared_memory(graph.process.pid) == []


def decisions(path: Path) -> int:
    return sum(len(json.loads(page.data)["rows"]) for page in McapReader(path).records([DECISIONS]))


def test_a_process_that_was_killed_leaves_its_flight_and_begins_another(
    run: Callable[..., Run],
    tmp_path: Path,
    overflight: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    graph = run("--record", "f.mcap")
    graph.until(lambda page: page["outputs"].get("work/out", {}).get("count", 0) > 15)
    graph.until(lambda page: decisions(tmp_path / "f.far.mcap") > 5)  # once a second they are safe
    os.kill(graph.pid("far"), signal.SIGKILL)
    page = graph.until(lambda page: page["processes"]["far"]["restarts"] == 1)
    worked = page["outputs"]["work/out"]["count"]
    graph.until(lambda page: bool(page["outputs"]["work/out"]["count"] > worked + 5))
    os.kill(graph.process.pid, signal.SIGINT)
    graph.report()
    lives = sorted(file.name for file in tmp_path.glob("f.far*.mcap"))
    assert lives == ["f.far.2.mcap", "f.far.mcap"]
    for life in lives:
        info = json.loads(overflight("info", life, "--json").out)
        assert info["decisions"] > (5 if life == "f.far.mcap" else 0)
        assert info["whole"] == (life == "f.far.2.mcap")
    monkeypatch.chdir(tmp_path)
    pages = json.loads(overflight("run", "f.mcap", "--as-recorded", "--json").out)
    assert list(pages) == ["f.far.mcap", "f.far.2.mcap", "f.main.mcap"]
    assert all(page["replay"]["decisions_identical"] for page in pages.values())
    assert all(page["replay"]["outputs_different"] == 0 for page in pages.values())
    asked = overflight("explain", "f.mcap", "--stage", "work").err
    assert "explain one of them: f.far.mcap or f.far.2.mcap" in asked
