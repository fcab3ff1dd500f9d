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
    from tools.recording.several import flight_files

    files = flight_files(flight) or [flight]  # what is no flight says so itself
    if graph:
        typer.echo(Flight(files[0]).manifest.text, nl=False)
        return
    found = [describe(file) for file in files]
    if as_json:
        pages = [asdict(one) for one in found]
        typer.echo(json.dumps(pages if len(pages) > 1 else pages[0], indent=2))
        return
    for number, one in enumerate(found):
        print_info(one, Console())
        if number + 1 < len(found):
            typer.echo()
