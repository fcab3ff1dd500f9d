"""`overflight compare`: one recording through two settings of a graph, agreement beside cost.

Every port that may differ gets a tap, a sink of our own, on both sides. A tap takes every message,
so a stage with `run: wanted` runs on every frame here.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import typer
from rich.console import Console

from pipeline.drivers.run import RunResult, run_graph
from pipeline.drivers.snapshot import Snapshot
from pipeline.errors import DataError
from pipeline.graph.catalog import Catalog
from pipeline.graph.graph import Graph
from pipeline.measuring.quantiles import milliseconds
from pipeline.message import Message
from pipeline.stage import Stage
from tools.comparing.compare_report import print_comparison
from tools.comparing.compare_timing import Timer, timed
from tools.comparing.comparison import COMPARISONS, Comparison
from tools.comparing.graph_difference import changed_stages
from tools.load import open_graph
from tools.running.run import make_room_for
from tools.validate import print_warnings
from tools.watching.progress import Progress

#: Names of the stages that are put on the compared ports; no graph would use them.
TAP = "compared_{}"
#: Shorter than the time between two frames: the first ones alone.
FIRST_FRAMES_S = 1e-9


class Tap(Stage):
    """Keeps a digest of every message of a port, by stamp, for the comparison."""

    def __init__(self, *, comparison: Any = None, kept: Any = None) -> None:
        self._comparison: Comparison | None = comparison
        self._kept: dict[int, Any] = {} if kept is None else kept

    def process(self, message: Message[Any]) -> None:
        assert self._comparison is not None
        if self._comparison.last_only:
            self._kept.clear()
        self._kept[message.stamp] = self._comparison.digest(message.payload)


@dataclass(frozen=True, slots=True)
class Side:
    """One of the two: what is set, and what it said and cost."""

    name: str  #: a or b
    settings: Sequence[str]
    graph: Graph
    catalog: Catalog
    timer: Timer
    kept: dict[str, dict[int, Any]]  #: digests by port, then stamp


def compare_file(
    path: Path,
    *,
    settings: Sequence[str] = (),
    a: Sequence[str] = (),
    b: Sequence[str] = (),
    overlays: Sequence[Path] = (),
    models: Sequence[Path] = (),
    duration_s: float | None = None,
    out: Path = Path("out"),
    report: Path | None = None,
    as_json: bool = False,
    quiet: bool = False,
) -> Sequence[str]:
    """Run both, tell of it, and return what failed (empty when all is well).

    Raises DataError where a and b do not differ in anything that can be compared.
    """
    if report is not None:
        make_room_for(report)
    sides, ports, skipped = _prepare(path, settings, {"a": a, "b": b}, overlays, models, out)
    console = Console(stderr=True)
    if not quiet:
        warnings = (warning for side in sides for warning in side.graph.warnings)
        print_warnings(list(dict.fromkeys(warnings)))
    results = [_run(side, duration_s, None if quiet else console) for side in sides]
    page = {
        "graph": sides[0].graph.name,
        **{
            side.name: _costs(side, result, ports)
            for side, result in zip(sides, results, strict=True)
        },
        "agreement": {port: _agreement(sides, port, make()) for port, make in ports.items()},
        "not_compared": skipped,
    }
    text = json.dumps(page, indent=2)
    if report is not None:
        report.write_text(text + "\n")
    if as_json:
        typer.echo(text)
    elif not quiet:
        print_comparison(page, Console())
    return [failure for result in results for failure in result.failures]


def _prepare(
    path: Path,
    settings: Sequence[str],
    differ: Mapping[str, Sequence[str]],
    overlays: Sequence[Path],
    models: Sequence[Path],
    out: Path,
) -> tuple[list[Side], dict[str, Callable[[], Comparison]], list[str]]:
    """Both sides with taps on every port that may differ, and the ports that cannot be compared."""
    plain = [
        open_graph(path, [*settings, *own], overlays, models, out)[0] for own in differ.values()
    ]
    stages = changed_stages(*plain)
    ports: dict[str, Callable[[], Comparison]] = {}
    skipped = []
    for stage in stages:
        for output in stage.contract.outputs:
            port = f"{stage.name}/{output.name}"
            makers = [COMPARISONS[kind] for kind in output.payload if kind in COMPARISONS]
            if makers:
                ports[port] = makers[0]
            else:
                skipped.append(port)
    if not ports:
        raise DataError(
            f"{path}: a and b differ in nothing that can be compared; say what differs, as "
            "--b stages.segment_rgb.executor=cpu"
        )
    taps = [
        f"stages.{TAP.format(number)}="
        f"{{use: 'tools.comparing.compare:Tap', inputs: {{message: {port}}}}}"
        for number, port in enumerate(ports)
    ]
    sides = []
    for name, own in differ.items():
        graph, catalog = open_graph(path, [*settings, *own, *taps], overlays, models, out / name)
        sides.append(_instrumented(Side(name, own, graph, catalog, Timer(), {}), ports))
    return sides, ports, skipped


def _instrumented(side: Side, ports: Mapping[str, Callable[[], Comparison]]) -> Side:
    """The side with its taps connected and its devices known by name to the one who times them."""
    stages = {stage.name: stage for stage in side.graph.stages}
    for number, (port, make) in enumerate(ports.items()):
        side.kept[port] = {}
        options = {"comparison": make(), "kept": side.kept[port]}
        name = TAP.format(number)
        stages[name] = replace(stages[name], options=MappingProxyType(options))
    graph, catalog = timed(
        replace(side.graph, stages=tuple(stages.values())), side.catalog, side.timer
    )
    return replace(side, graph=graph, catalog=catalog)


def _run(side: Side, duration_s: float | None, console: Console | None) -> RunResult:
    """Run one side offline; the first frames twice, so that no compiling is in its figures.

    Raises KeyboardInterrupt where a signal ended it: the other side is not to begin.
    """
    with contextlib.ExitStack() as stack:
        shown: Callable[[Snapshot], None] | None = None
        if console is not None:
            console.print(f"{side.name}: {', '.join(side.settings) or 'the file as it is'}")
            shown = stack.enter_context(Progress(side.graph.topology, console))
        for seconds in (FIRST_FRAMES_S, duration_s):
            for kept in side.kept.values():
                kept.clear()
            result = run_graph(
                side.graph, side.catalog, speed=None, duration_s=seconds, progress=shown
            )
            if result.ended.startswith("signal"):
                raise KeyboardInterrupt
    return result


def _costs(
    side: Side, result: RunResult, ports: Mapping[str, Callable[[], Comparison]]
) -> dict[str, Any]:
    """What each compared stage cost a run, in ms."""
    stages = {}
    for name in dict.fromkeys(port.partition("/")[0] for port in ports):
        measured = result.report["stages"][name]
        page: dict[str, Any] = {"runs": measured["runs"], "cpu_ms": measured["cpu_ms"]}
        stage = side.graph.stage(name)
        for device in stage.ladder:
            took = side.timer.took.get((stage.model or "", device))
            if took and took.count:
                page |= {"model": stage.model, "device": device, "device_ms": milliseconds(took)}
                page["latency_ms"] = _latency(page)
                break
        stages[name] = page
    return {"settings": list(side.settings), "wall_s": result.report["wall_s"], "stages": stages}


def _latency(page: Mapping[str, Any]) -> float:
    """Prepare, device and finish one after another, without any waiting: medians and means."""
    cpu = page["cpu_ms"]
    parts = (cpu.get("prepare", 0.0), page["device_ms"]["p50"], cpu.get("finish", 0.0))
    return round(float(sum(parts)), 3)


def _agreement(sides: Sequence[Side], port: str, comparison: Comparison) -> dict[str, Any]:
    """The agreement on one port, over the stamps that both sides have."""
    a, b = (side.kept[port] for side in sides)
    common = sorted(a.keys() & b.keys())
    for stamp in common:
        comparison.add(a[stamp], b[stamp])
    counts = {
        "messages": len(common),
        "messages_only_a": len(a) - len(common),
        "messages_only_b": len(b) - len(common),
    }
    return counts | comparison.page()
