"""`overflight check`: runs a graph and says whether it kept to what its file expects."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import typer
from rich.console import Console
from rich.table import Table

from pipeline.drivers.run import run_graph
from pipeline.graph.graph import Graph
from pipeline.measuring.expectations import QUANTITIES, Verdict, verdicts
from tools.load import open_graph
from tools.validate import print_warnings
from tools.watching.progress import Progress

#: What `--on` sets where it does not say.
RECORDING = "recording"


def check_file(
    path: Path,
    *,
    on: Sequence[str] = (),
    settings: Sequence[str] = (),
    overlays: Sequence[Path] = (),
    models: Sequence[Path] = (),
    speed: float | None = 1.0,
    duration_s: float | None = None,
    out: Path = Path("out"),
    as_json: bool = False,
) -> bool:
    """Run it, print every expectation with what was found; True where all is well.

    Raises typer.BadParameter where the file expects nothing.
    """
    graph, catalog = open_graph(path, [*settings, *map(_setting, on)], overlays, models, out)
    if not expects(graph):
        raise typer.BadParameter(
            f"{path} has no 'expect' block, so there is nothing to check; "
            "for example expect: {outputs: {NAME: {min_rate_hz: 9}}}"
        )
    print_warnings(graph.warnings)
    with Progress(graph.topology, Console(stderr=True)) as progress:
        result = run_graph(graph, catalog, speed=speed, duration_s=duration_s, progress=progress)
    judged = verdicts(graph.expect, result.report)
    well = not result.failures and all(verdict.met is not False for verdict in judged)
    if as_json:
        found = {
            "graph": graph.name,
            "wall_s": result.report["wall_s"],
            "well": well,
            "failures": list(result.failures),
            "expectations": [asdict(verdict) for verdict in judged],
        }
        typer.echo(json.dumps(found, indent=2))
    else:
        Console().print(verdict_table(judged))
        for failure in result.failures:
            typer.secho(failure, fg=typer.colors.RED, err=True)
    return well


def expects(graph: Graph) -> bool:
    """Whether the file expects anything."""
    rules = graph.expect.model_dump(exclude_none=True)
    return any(rules.values())


def verdict_table(judged: Sequence[Verdict]) -> Table:
    """One line for each expectation."""
    table = Table("expected of", "", box=None, pad_edge=False, header_style="bold")
    for column in ("limit", "found"):
        table.add_column(column, justify="right")
    table.add_column("")
    words = {True: "[green]met[/]", False: "[red]not met[/]", None: "[dim]not judged offline[/]"}
    for one in judged:
        name, unit = QUANTITIES[one.key]
        of = one.of.replace("/out->", " -> ").removesuffix("/out")
        sign = ">=" if one.key.startswith("min") else "<="
        found = "-" if one.found is None else f"{one.found:.4g} {unit}"
        table.add_row(of, name, f"{sign} {one.limit:g} {unit}", found, words[one.met])
    return table


def _setting(on: str) -> str:
    """``FOLDER`` is the parameter `recording`; ``flight=FILE`` is the parameter of that name."""
    name, equals, value = on.partition("=")
    return f"parameters.{name}={value}" if equals else f"parameters.{RECORDING}={on}"
