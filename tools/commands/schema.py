"""The words of `overflight schema`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from tools.commands.app import app, emit, examples


@app.command(epilog=examples("overflight schema -o graph.schema.json"))
def schema(
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE", help="Write to a file.", show_default="print"
        ),
    ] = None,
) -> None:
    """Print the JSON schema of the graph file, for editors."""
    from pipeline.graph.spec import graph_schema

    emit(json.dumps(graph_schema(), indent=2), output)
