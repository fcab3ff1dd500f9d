"""`overflight profile`: what every stage costs on this machine, alone or over rates and devices."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Sequence
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
    for file in (html, plot, costs):
        if file is not None:
            make_room_for(file)
    print_warnings(graph.warnings)
    err = Console(stderr=True, highlight=False, soft_wrap=True)
    table = CostTable()
    machine = sentence(describe())

    def overlay(file: Path) -> Graph:
        return open_graph(path, settings, [*overlays, file], models, out)[0]

    page: dict[str, Any] | None = None
    swept: list[dict[str, Any]] = []
    if sweep:
        every = points(graph, catalog, asked, overlay)
        swept = _sweep(graph, catalog, every, duration_s or SECONDS_OF_A_POINT, table, err)
        failures = [f"{point['variant']}: {point['failed']}" for point in swept if point["failed"]]
        failures = [] if any(not point["failed"] for point in swept) else failures
    else:
        result = _once(graph, catalog, duration_s or SECONDS, err)
        table.add(graph, result.report)
        page = profile_page(graph, result.report)
        failures = list(result.failures)

    if as_json:
        typer.echo(json.dumps({"machine": machine, "profile": page, "sweep": swept}, indent=2))
    else:
        console = Console()
        if page is not None:
            print_profile(page, console)
        else:
            print_sweep(swept, console)
    if html is not None:
        command = shlex.join(["overflight", *sys.argv[1:]])
        html.write_text(html_page(page, Diagram.of(graph), swept, machine, command))
    if plot is not None:
        plot.write_text(sweep_plot(swept) + "\n")
    if costs is not None:
        table.write(costs, graph)
    for file in (html, plot, costs):
        if file is not None:
            err.print(f"Written: {file}")
    return failures


def _once(graph: Graph, catalog: Catalog, seconds: float, err: Console) -> RunResult:
    err.print(f"warming up, then {seconds:g} s of {graph.name} in real time ...")
    run_graph(graph, catalog, duration_s=min(WARM_UP_S, seconds))
    with Progress(graph.topology, err) as progress:
        return run_graph(graph, catalog, duration_s=seconds, progress=progress)


def _sweep(
    graph: Graph,
    catalog: Catalog,
    every: Sequence[Point],
    seconds: float,
    table: CostTable,
    err: Console,
) -> list[dict[str, Any]]:
    runs = sum(point.why_not is None for point in every)
    minutes = (runs * (seconds + OPENING_S) + WARM_UP_S + OPENING_S) / 60
    err.print(f"{runs} runs of {seconds:g} s, at most: about {minutes:.1f} min; warming up ...")
    run_graph(graph, catalog, duration_s=WARM_UP_S)
    say: Callable[[str], None] = err.print

    def done(point: Point, result: RunResult) -> None:
        table.add(point.graph, result.report)

    return list(run_points(every, catalog, seconds, say, done))
