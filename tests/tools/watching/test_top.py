from __future__ import annotations

import io
import json
import signal
import threading
import time
from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from driving import arrive
from rich.console import Console

from pipeline.measuring.board import Board, read_board
from tools.watching.top import fitted, screen

Overflight = Callable[..., Any]

OPENING = {"format": 1, "graph": "uav", "pid": 4711, "began": 0.0, "state": "opening"}
STAGE = {
    "runs": 90,
    "runs_hz": 9.1,
    "cpu_cores": 0.129,
    "lost": 0,
    "lost_hz": 0.0,
    "running": 1,
    "errors": 0,
    "stopped": False,
}
HELD = {"queued": 1, "queued_peak": 3, "waiting": 2}
PAGE: dict[str, Any] = OPENING | {
    "state": "running",
    "speed": 1.0,
    "elapsed_s": 12.5,
    "cpu_cores": 0.481,
    "outputs": {
        "rgb/out": {"count": 375, "rate_hz": 30.0, "silent_s": 0.01, "ages_ms": {"rgb/out": 5.0}},
        "lidar/out": {"count": 7, "rate_hz": 10.0, "silent_s": 0.1, "ages_ms": {"lidar/out": 50.0}},
        "fuse/out": {
            "count": 90,
            "rate_hz": 9.0,
            "silent_s": 0.05,
            "ages_ms": {"lidar/out": 113.2, "rgb/out": 157.4},
        },
    },
    "stages": {"rgb": STAGE, "lidar": STAGE, "fuse": STAGE | HELD},
    "edges": {},
    "devices": {
        "igpu": {
            "up": True,
            "runs": 82,
            "busy_fraction": 0.343,
            "inferring": "segment",
            "stages": ["segment"],
        }
    },
    "failures": [],
    "events": [{"at_s": 6.2, "kind": "stale", "of": "rgb/out->fuse/rgb", "text": "late\nlines"}],
}


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of boards, of this test alone."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "overflight"


@pytest.fixture
def put_up() -> Iterator[Callable[..., Board]]:
    """Puts up boards until the end of the test."""
    boards: list[Board] = []

    def put(**changes: Any) -> Board:
        boards.append(Board())
        boards[-1].write(PAGE | changes)
        return boards[-1]

    yield put
    for board in boards:
        board.close()


def shown(**changes: Any) -> str:
    console = Console(file=io.StringIO(), width=100)
    console.print(screen(PAGE | changes))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def row(text: str, name: str) -> list[str]:
    """The cells of the first line that begins with a name."""
    return next(line.split() for line in text.splitlines() if line.startswith(f"{name} "))


def test_where_nothing_runs_it_says_what_to_do(overflight: Overflight) -> None:
    answer = overflight("top", "--once")
    assert answer.code == 2
    assert answer.err.strip() == (
        "no graph runs here; start one in another shell: overflight run GRAPH"
    )


def test_once_prints_the_one_run(overflight: Overflight, put_up: Callable[..., Board]) -> None:
    put_up()
    answer = overflight("top", "--once")
    assert answer.code == 0
    assert "uav   process 4711   running for 12 s   CPU 48.1 % of a core" in answer.out


def test_once_as_json_is_the_page_itself(
    overflight: Overflight, put_up: Callable[..., Board]
) -> None:
    put_up()
    assert json.loads(overflight("top", "--once", "--json").out) == PAGE


def test_several_runs_are_listed_and_one_is_picked_by_name_or_process(
    overflight: Overflight, put_up: Callable[..., Board]
) -> None:
    put_up()
    put_up(graph="car", pid=42)
    answer = overflight("top", "--once")
    assert row(answer.out, "uav")[:3] == ["uav", "4711", "running"]
    assert row(answer.out, "car")[:3] == ["car", "42", "running"]
    for word in ("car", "42"):
        assert json.loads(overflight("top", word, "--once", "--json").out)["pid"] == 42
    unclear = overflight("top", "--once", "--json")
    assert unclear.code == 2
    assert "uav (process 4711), car (process 42)" in unclear.err


def test_a_name_that_does_not_run_is_told_with_those_that_do(
    overflight: Overflight, put_up: Callable[..., Board]
) -> None:
    put_up()
    answer = overflight("top", "ship")
    assert answer.code == 2
    assert answer.err.strip() == "no running graph 'ship'; there are uav (process 4711)"


def test_json_is_a_line_per_page_until_the_run_ends(
    overflight: Overflight, put_up: Callable[..., Board], monkeypatch: pytest.MonkeyPatch
) -> None:
    board = put_up()
    pages = iter([PAGE | {"elapsed_s": 13.0}])

    def sleep(seconds: float) -> None:
        following = next(pages, None)
        if following is None:
            board.path.unlink()
        else:
            board.write(following)

    monkeypatch.setattr(time, "sleep", sleep)
    lines = overflight("top", "--json").out.splitlines()
    assert [json.loads(line)["elapsed_s"] for line in lines] == [12.5, 13.0]


def test_a_stage_has_its_rates_load_queue_and_losses() -> None:
    stages = PAGE["stages"] | {"fuse": STAGE | HELD | {"lost": 7, "lost_hz": 1.3}}
    text = shown(stages=stages)
    cells = ["fuse", "9.0", "9.1", "12.9", "1", "3", "2", "1.3", "7"]
    assert row(text, "fuse") == cells
    assert row(text, "rgb") == ["rgb", "30.0", "12.9"]  # a source has no queue


def test_ages_are_a_table_of_outputs_by_sensors() -> None:
    lines = shown().splitlines()
    head = next(number for number, line in enumerate(lines) if line.startswith("age"))
    assert lines[head].split()[-2:] == ["rgb", "lidar"]
    assert lines[head + 1].split() == ["fuse", "157", "113"]


def test_a_low_terminal_shows_the_run_in_brief_to_its_last_line() -> None:
    outputs = PAGE["outputs"] | {"map/out": PAGE["outputs"]["fuse/out"]}
    stages = PAGE["stages"] | {"map": STAGE | HELD}
    page = PAGE | {"outputs": outputs, "stages": stages, "edges": {"fuse/out->map/cloud": {}}}

    def on_a_terminal(height: int) -> str:
        console = Console(file=io.StringIO(), width=80, height=height)
        console.print(fitted(page, console))
        assert isinstance(console.file, io.StringIO)
        return console.file.getvalue()

    assert on_a_terminal(24) == on_a_terminal(50)
    brief = on_a_terminal(12)
    assert "sensors, Hz: rgb 30.0, lidar 10.0" in brief
    assert row(brief, "fuse")[:2] == ["fuse", "9.0"]
    ages = brief.partition("age when published")[2].splitlines()
    assert ages[1].split() == ["map", "157", "113"]  # and not those of what it was made of
    assert row(brief, "igpu") == ["igpu", "up", "34.3", "82", "segment"]
    assert len(brief.splitlines()) < len(on_a_terminal(50).splitlines())


def test_an_overdue_stream_is_told() -> None:
    outputs = deepcopy(PAGE["outputs"])
    outputs["lidar/out"]["silent_s"] = 3.2
    assert row(shown(outputs=outputs), "lidar")[1:5] == ["none", "for", "3.2", "s"]
    outputs["lidar/out"] = {"count": 0, "rate_hz": 0.0, "silent_s": None, "ages_ms": {}}
    assert row(shown(outputs=outputs), "lidar")[1] == "-"


def test_devices_failures_and_events_are_shown() -> None:
    lost = {"igpu": PAGE["devices"]["igpu"] | {"up": False, "inferring": None}}
    text = shown(devices=lost, failures=["fuse: no"])
    assert row(shown(), "igpu") == ["igpu", "up", "34.3", "82", "segment", "segment"]
    assert row(text, "igpu") == ["igpu", "lost", "34.3", "82", "segment"]
    assert "fuse: no" in text
    assert "6.20 s  stale rgb/out->fuse/rgb: late\n" in text


def test_a_graph_that_opens_has_no_tables_yet() -> None:
    console = Console(file=io.StringIO(), width=100)
    console.print(screen(OPENING))
    assert isinstance(console.file, io.StringIO)
    assert "are being opened" in console.file.getvalue()


@pytest.mark.slow
@pytest.mark.realtime
def test_a_run_is_seen_while_it_runs_and_gone_after(overflight: Overflight, place: Path) -> None:
    seen: list[dict[str, Any]] = []
    over = threading.Event()

    def look() -> None:
        """Until a page with rates is up; then the run may end."""
        while not over.wait(0.1):
            for path in place.glob("*.run"):
                page = read_board(path)
                if page is not None and page["state"] == "running":
                    seen.append(page)
                    if page["outputs"]["camera/out"]["rate_hz"]:
                        arrive(signal.SIGINT)
                        return

    Path("hello.yaml").write_text(
        "overflight: 1\ngraph: hello\nstages:\n"
        "  camera: {use: stages.sources.emulated:EmulatedCamera, options: {width: 9, height: 9}}\n"
    )
    looking = threading.Thread(target=look)
    looking.start()
    try:
        answer = overflight("run", "hello.yaml", "--duration", "60", "--quiet")
    finally:
        over.set()
        looking.join()
    assert answer.code == 0
    assert seen[-1]["graph"] == "hello"
    camera = seen[-1]["outputs"]["camera/out"]
    assert camera["count"] > 0
    assert camera["rate_hz"] > 0
    assert list(place.iterdir()) == []
