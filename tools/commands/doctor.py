"""The words of `overflight doctor`."""

from __future__ import annotations

from pathlib import Path

import typer

from tools.commands.app import RUN_FAILED, app, examples
from tools.commands.options import AsJson, GraphFile, ModelFiles, Out, Overlays, Settings


@app.command(epilog=examples("overflight doctor graphs/drive.yaml --models my_models.yaml"))
def doctor(
    graph: GraphFile,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    out: Out = Path("out"),
    as_json: AsJson = False,
) -> None:
    """Check a graph against this machine: devices, drivers, model files. Exit code 1: something is
    missing."""
    from tools.doctor import doctor_file

    ready = doctor_file(
        graph,
        settings=settings or (),
        overlays=overlays or (),
        models=models or (),
        out=out,
        as_json=as_json,
    )
    if not ready:
        raise typer.Exit(RUN_FAILED)
