"""`overflight profile`: what every stage costs on this machine, alone or over rates and devices."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from pipeline.drivers.run import RunResult, run_graph
from pipeline.graph.catalog import Catalog
from pipeline.graph.graph import Graph
from tools.bench.machine import describe, sentence
from tools.drawing.diagram import Diagram
from tools.drawing.html_report import html_page, sweep_plot
from tools.load import open_graph
from tools.profiling.profile_costs import CostTable
from tools.profiling.profile_page import profile_page
from tools.profiling.profile_sweep import Point, Sweep, points, run_points
from tools.profiling.profile_table import print_profile, print_sweep
from tools.running.run import make_room_for
from tools.validate import print_warnings
from tools.watching.progress import Progress

#: What a run takes unless the user says otherwise.
SECONDS, SECONDS_OF_A_POINT = 20.0, 5.0
#: A first run that does not count: kernels are loaded or compiled, caches are filled.
WARM_UP_S = 1.0
#: Opening and closing a run, roughly, for the estimate.
OPENING_S = 1.0


def profile_file(
    path: Path,
    *,
    settings: Sequence[str] = (),
    overlays: Sequence[Path] = (),
    models: Sequence[Path] = (),
    sweep: Sequence[str] = (),
    duration_s: float | None = None,
    out: Path = Path("out"),
    html: Path | None = None,
    plot: Path | None = None,
    costs: Path | None = None,
    as_json: bool = False,
) -> Sequence[str]:
    """Profile, tell of it, write what was asked for; returns what failed (empty: all is well)."""
    asked = Sweep.parse(sweep)
    if plot is not None and not sweep:
        raise typer.BadParameter("--plot draws a sweep; add one, e.g. --sweep executor")
    graph, catalog = open_graph(path, settings, overlays, models, out)
    written = [file for file in (html, plot, costs) if file is not None]
    for file in written:
        make_room_for(file)
    print_warnings(graph.warnings)
    err = Console(stderr=True, highlight=False, soft_wrap=True)
    machine = sentence(describe())  # with its load before the first run

    def overlay(file: Path) -> Graph:
        return open_graph(path, settings, [*overlays, file], models, out)[0]

    if sweep:
        every = points(graph, catalog, asked, overlay)
        measured = _sweep(graph, catalog, every, duration_s or SECONDS_OF_A_POINT, err)
    else:
        measured = _once(graph, catalog, duration_s or SECONDS, err)
    measured.show(machine, as_json=as_json)
    if html is not None:
        command = shlex.join(["overflight", *sys.argv[1:]])
        page = html_page(measured.page, Diagram.of(graph), measured.swept, machine, command)
        html.write_text(page)
    if plot is not None:
        plot.write_text(sweep_plot(measured.swept) + "\n")
    if costs is not None:
        measured.costs.write(costs, graph)
    for file in written:
        err.print(f"Written: {file}")
    return measured.failures


@dataclass(frozen=True, slots=True)
class _Measured:
    """What one run, or the runs of a sweep, have told."""

    costs: CostTable
    page: dict[str, Any] | None  #: of one run
    swept: list[dict[str, Any]]  #: of the runs of a sweep
    failures: list[str]

    def show(self, machine: str, *, as_json: bool) -> None:
        if as_json:
            told = {"machine": machine, "profile": self.page, "sweep": self.swept}
            typer.echo(json.dumps(told, indent=2))
        elif self.page is not None:
            print_profile(self.page, Console())
        else:
            print_sweep(self.swept, Console())


def _once(graph: Graph, catalog: Catalog, seconds: float, err: Console) -> _Measured:
    err.print(f"warming up, then {seconds:g} s of {graph.name} in real time ...")
    run_graph(graph, catalog, duration_s=min(WARM_UP_S, seconds))
    with Progress(graph.topology, err) as progress:
        result = run_graph(graph, catalog, duration_s=seconds, progress=progress)
    costs = CostTable()
    costs.add(graph, result.report)
    return _Measured(costs, profile_page(graph, result.report), [], list(result.failures))


def _sweep(
    graph: Graph, catalog: Catalog, every: Sequence[Point], seconds: float, err: Console
) -> _Measured:
    """A sweep has failed where none of its points is measured."""
    runs = sum(point.why_not is None for point in every)
    minutes = (runs * (seconds + OPENING_S) + WARM_UP_S + OPENING_S) / 60
    err.print(f"{runs} runs of {seconds:g} s, at most: about {minutes:.1f} min; warming up ...")
    run_graph(graph, catalog, duration_s=WARM_UP_S)
    say: Callable[[str], None] = err.print
    costs = CostTable()

    def done(point: Point, result: RunResult) -> None:
        costs.add(point.graph, result.report)

    swept = list(run_points(every, catalog, seconds, say, done))
    failures = [f"{point['variant']}: {point['failed']}" for point in swept if point["failed"]]
    return _Measured(costs, None, swept, failures if len(failures) == len(swept) else [])
