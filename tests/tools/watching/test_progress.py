from __future__ import annotations

import io
from types import SimpleNamespace
from typing import Any

from rich.console import Console

from pipeline.scheduling.topology import Input, Port, StageNode, Topology
from tools.watching.progress import PLAIN_PERIOD_S, Progress, end_ports, progress_line

TOPOLOGY = Topology(
    (
        StageNode("camera"),
        StageNode("detect", (Input("image", (Port("camera"),)),), ("out", "debug")),
        StageNode("file", (Input("boxes", (Port("detect"),)),), ()),
    )
)


def snapshot(elapsed_s: float, *events: Any, done: float | None = None) -> Any:
    output = SimpleNamespace(count=120, rate_hz=9.94, age_ms=141.6)
    quiet = SimpleNamespace(count=0, rate_hz=None, age_ms=None)
    outputs = {"camera/out": output, "detect/out": output, "detect/debug": quiet}
    return SimpleNamespace(
        elapsed_s=elapsed_s, outputs=outputs, dropped=31, events=events, done=done
    )


def console(terminal: bool) -> Console:
    return Console(file=io.StringIO(), force_terminal=terminal, width=100, legacy_windows=False)


def shown(target: Console) -> str:
    assert isinstance(target.file, io.StringIO)
    return target.file.getvalue()


def test_the_ends_are_the_ports_that_only_sinks_or_nobody_read() -> None:
    assert end_ports(TOPOLOGY) == ("detect/out", "detect/debug")


def test_the_line_tells_time_rate_age_and_drops() -> None:
    line = progress_line(snapshot(12.3), end_ports(TOPOLOGY))
    assert line == "  12.3 s   detect 9.9 Hz, 142 ms old   detect/debug 0 messages   31 dropped"


def test_where_the_end_is_known_the_line_tells_how_far_it_is() -> None:
    told = [
        progress_line(snapshot(elapsed_s, done=done), ()).split("   31 dropped")[0].strip()
        for elapsed_s, done in ((0.4, 0.01), (20.0, 0.25), (60.0, 0.1), (80.0, 1.0))
    ]
    assert told == [
        "0.4 s   1 %",
        "20.0 s   25 %, 60 s left",
        "60.0 s   10 %, 9 min left",
        "80.0 s   100 %, 0 s left",
    ]


def test_without_a_terminal_a_plain_line_comes_every_few_seconds() -> None:
    log = console(terminal=False)
    with Progress(TOPOLOGY, log) as progress:
        for tenth in range(int(30 * PLAIN_PERIOD_S)):
            progress(snapshot(tenth / 10))
    lines = shown(log).splitlines()[1:]  # the first says that the graph opens
    assert [float(line.split()[0]) for line in lines] == [5.0, 10.0]


def test_on_a_terminal_the_line_is_rewritten_in_place() -> None:
    screen = console(terminal=True)
    with Progress(TOPOLOGY, screen) as progress:
        progress(snapshot(1.0))
        progress(snapshot(2.0))
    assert "\x1b[2K" in shown(screen)
    assert shown(screen).count("31 dropped") >= 2


def test_an_event_is_told_once_when_it_happens() -> None:
    log = console(terminal=False)
    stale = SimpleNamespace(kind="stale", subject="fuse/scores", text="nothing came\nmore")
    with Progress(TOPOLOGY, log) as progress:
        progress(snapshot(1.0))
        progress(snapshot(1.5, stale))
        progress(snapshot(2.0, stale))
    assert shown(log).splitlines()[1:] == ["   1.5 s   stale fuse/scores: nothing came"]
