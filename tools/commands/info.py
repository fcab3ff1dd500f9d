"""The words of `overflight info`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from tools.commands.app import app
from tools.commands.options import AsJson


@app.command(
    epilog="Examples: overflight info flight.mcap. "
    "overflight info flight.mcap --graph > graph.yaml. overflight info flight.mcap --json"
)
def info(
    flight: Annotated[
        Path, typer.Argument(metavar="FLIGHT", help="An MCAP file.", show_default=False)
    ],
    graph: Annotated[
        bool, typer.Option("--graph", help="Print the graph file that it was recorded with.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Tell what a recording holds: topics, rates, gaps, losses, the graph and the versions."""
    from rich.console import Console

    from pipeline.recording.flight import Flight
    from tools.recording.info import describe, print_info

    if graph:
        typer.echo(Flight(flight).manifest.text, nl=False)
        return
    found = describe(flight)
    if as_json:
        typer.echo(json.dumps(asdict(found), indent=2))
    else:
        print_info(found, Console())
