"""Real processes, killed for real: what `overflight run` does with a graph of several."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

GRAPH = """\
overflight: 1
graph: apart
processes: {far: {nice: 5}}
stages:
  camera: {use: apart_stages:Frames, options: {rate_hz: 20}}
  lidar: {use: apart_stages:Frames, options: {rate_hz: 10, pixels: 300000}, process: far}
  work:
    use: apart_stages:Pair
    process: far
    inputs: {frame: lidar, other: {from: camera, sync: nearest, tolerance_ms: 60}}
  kept:
    use: stages.sinks.count:Count
    inputs: {message: {from: work, queue: {policy: block, size: 3}}}
"""
STAGES = """\
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.message import Message
from pipeline.stage import Source, Stage


@dataclass(frozen=True)
class Frame:
    number: int
    pixels: NDArray[np.uint8]


class Frames(Source):
    def __init__(self, *, rate_hz: float, pixels: int = 10, count: int = 0) -> None:
        self.rate_hz, self.pixels, self.count = rate_hz, pixels, count

    def messages(self) -> Iterator[Message[Frame]]:
        number = 0
        while not self.count or number < self.count:
            number += 1
            pixels = np.full(self.pixels, number % 256, np.uint8)
            yield Message.at(round(number * 1e9 / self.rate_hz), Frame(number, pixels))


class Pair(Stage):
    def process(self, frame: Message[Frame], other: Message[Frame] | None) -> Frame:
        assert (frame.payload.pixels == frame.payload.number % 256).all()
        return frame.payload
"""


class Run:
    """`overflight run` in the background, watched in a folder of this test alone."""

    def __init__(self, folder: Path, *words: str) -> None:
        (folder / "apart.yaml").write_text(GRAPH)
        (folder / "apart_stages.py").write_text(STAGES)
        self._folder = folder
        command = [sys.executable, "-m", "tools.main", "run", "apart.yaml"]
        self.process = subprocess.Popen(
            [*command, "--report", "report.json", *words],
            cwd=folder,
            env={**os.environ, "XDG_RUNTIME_DIR": str(folder)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._seen: dict[int, psutil.Process] = {}

    def page(self) -> dict[str, Any]:
        """What `overflight top --once --json` reads: how the run stands."""
        from pipeline.measuring.board import boards, read_board

        for board in boards(self._folder / "overflight"):
            return read_board(board) or {}
        return {}

    def until(
        self, what: Callable[[dict[str, Any]], bool], limit_s: float = 60.0
    ) -> dict[str, Any]:
        """Wait until the page of the run is so."""
        deadline = time.monotonic() + limit_s
        while time.monotonic() < deadline:
            page = self.page()
            for name in page.get("processes", {}):
                with contextlib.suppress(psutil.NoSuchProcess):  # killed since
                    pid = page["processes"][name]["pid"]
                    self._seen.setdefault(pid, psutil.Process(pid))
            if page and what(page):
                return page
            assert self.process.poll() is None, self.process.communicate()[0]
            time.sleep(0.05)
        raise AssertionError(f"not within {limit_s} s: {self.page()}")

    def pid(self, name: str) -> int:
        return int(self.page()["processes"][name]["pid"])

    def report(self, code: int = 0) -> dict[str, Any]:
        """The report of the ended run, which left nothing behind."""
        text, _ = self.process.communicate(timeout=60)
        assert self.process.returncode == code, text
        assert shared_memory(self.process.pid) == []
        report: dict[str, Any] = json.loads((self._folder / "report.json").read_text())
        return report

    def assert_no_process_is_left(self) -> None:
        assert self._seen
        _, alive = psutil.wait_procs(self._seen.values(), timeout=10)
        assert alive == []

    def close(self) -> None:
        self.process.kill()
        if self.process.stdout and not self.process.stdout.closed:
            self.process.communicate()


def shared_memory(supervisor: int) -> list[Path]:
    """What is left of the shared memory of a run."""
    return list(Path("/dev/shm").glob(f"overflight-apart-{supervisor}-*"))


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Callable[..., Run]]:
    started: list[Run] = []

    def start(*words: str) -> Run:
        started.append(Run(tmp_path, *words))
        return started[-1]

    yield start
    for each in started:
        each.close()


def flows(page: dict[str, Any]) -> bool:
    return bool(page["outputs"].get("work/out", {}).get("count", 0) >= 5)


def test_the_processes_of_a_graph_end_with_its_sources_and_one_report(
    run: Callable[..., Run],
) -> None:
    counts = ["--set", "stages.camera.options.count=40", "--set", "stages.lidar.options.count=20"]
    report = run(*counts).report()
    assert report["ended"] == "sources ended"
    assert report["ledger_balanced"]
    assert report["outputs"]["work/out"]["count"] == 20
    kept = report["edges"]["work/out->kept/message"]
    assert (kept["produced"], kept["delivered"], kept["dropped"]) == (20, 20, {})
    assert set(report["processes"]) == {"main", "far"}
    assert report["cpu"]["parts_cores"]["transport"] > 0


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
