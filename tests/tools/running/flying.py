"""`overflight run` in the background, with real processes, for tests that kill them."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import psutil

from pipeline.measuring.board import boards, read_board

#: `far` has a LiDAR and pairs its frames with those of a camera here, where the pairs are counted.
TWO_PROCESSES = """\
overflight: 1
graph: apart
processes: {far: {nice: 5}}
stages:
  camera: {use: apart_stages:Frames, options: {rate_hz: 20}}
  lidar: {use: apart_stages:Frames, options: {rate_hz: 10, pixels: 300000}, process: far}
  work:
    use: apart_stages:Pair
    process: far
    inputs:
      frame: {from: lidar, queue: {policy: drop_oldest, size: 30}}
      other: {from: camera, sync: nearest, tolerance_ms: 60}
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
    """`overflight run apart.yaml` in the background, watched in a folder of this run alone.

    The graph in `folder` may name the stages of the module ``apart_stages``. `before` are words
    before the command.
    """

    def __init__(
        self, folder: Path, *words: str, watched: str = "", before: Sequence[str] = ()
    ) -> None:
        self._folder = folder / watched
        self._folder.mkdir(exist_ok=True)
        self._report = self._folder / "report.json"
        (folder / "apart_stages.py").write_text(STAGES)
        command = [*before, sys.executable, "-m", "tools.main", "run", "apart.yaml"]
        self.process = subprocess.Popen(
            [*command, "--report", str(self._report), *words],
            cwd=folder,
            env={**os.environ, "XDG_RUNTIME_DIR": str(self._folder)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._seen: dict[int, psutil.Process] = {}

    def page(self) -> dict[str, Any]:
        """How the run stands."""
        return self.until(lambda page: True)

    def _read(self) -> dict[str, Any]:
        """What `overflight top --once --json` reads; nothing where no whole page is up just now."""
        for board in boards(self._folder / "overflight"):
            return read_board(board) or {}
        return {}

    def until(
        self, what: Callable[[dict[str, Any]], bool], limit_s: float = 200.0
    ) -> dict[str, Any]:
        """Wait until the page of the run is so."""
        deadline = time.monotonic() + limit_s
        while time.monotonic() < deadline:
            page = self._read()
            for name in page.get("processes", {}):
                with contextlib.suppress(psutil.NoSuchProcess):  # killed since
                    pid = page["processes"][name]["pid"]
                    self._seen.setdefault(pid, psutil.Process(pid))
            if page and what(page):
                return page
            assert self.process.poll() is None, self.process.communicate()[0]
            time.sleep(0.05)
        raise AssertionError(f"not within {limit_s} s: {self._read()}")

    def pid(self, name: str) -> int:
        return int(self.page()["processes"][name]["pid"])

    def report(self, code: int = 0) -> dict[str, Any]:
        """The report of the ended run, which left nothing behind."""
        text, _ = self.process.communicate(timeout=200)
        assert self.process.returncode == code, text
        assert shared_memory(self.process.pid) == []
        report: dict[str, Any] = json.loads(self._report.read_text())
        return report

    def assert_no_process_is_left(self) -> None:
        assert self._seen
        _, alive = psutil.wait_procs(self._seen.values(), timeout=60)
        assert alive == []

    def close(self) -> None:
        self.process.kill()
        if self.process.stdout and not self.process.stdout.closed:
            self.process.communicate()


def shared_memory(supervisor: int) -> list[Path]:
    """What is left of the shared memory of a run."""
    return list(Path("/dev/shm").glob(f"overflight-apart-{supervisor}-*"))
