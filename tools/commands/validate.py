"""The words of `overflight validate`."""

from __future__ import annotations

from pathlib import Path

import typer

from tools.commands.app import USER_MISTAKE, app, examples
from tools.commands.options import AsJson, GraphFile, ModelFiles, Out, Overlays, Settings


@app.command(epilog=examples("overflight validate graphs/drive.yaml --overlay at_home.yaml"))
def validate(
    graph: GraphFile,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    out: Out = Path("out"),
    as_json: AsJson = False,
) -> None:
    """Find every mistake in a graph file without running it."""
    from tools.validate import validate_file

    valid = validate_file(
        graph,
        settings=settings or (),
        overlays=overlays or (),
        models=models or (),
        out=out,
        as_json=as_json,
    )
    if not valid:
        raise typer.Exit(USER_MISTAKE)
