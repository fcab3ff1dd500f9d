"""The words of `overflight check`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tools.commands.app import RUN_FAILED, app, examples
from tools.commands.options import (
    AsJson,
    GraphFile,
    ModelFiles,
    Out,
    Overlays,
    Settings,
    parse_speed,
)


@app.command(
    epilog=examples(
        "overflight check graphs/drive.yaml --on my_drive --overlay limits.yaml",
        "overflight check uav.yaml --on flight=field.mcap --duration 60 --json",
    )
)
def check(
    graph: GraphFile,
    on: Annotated[
        list[str] | None,
        typer.Option(
            "--on",
            metavar="RECORDING",
            help="What to run it on: the value of the file's parameter `recording`, or NAME=VALUE "
            "for a parameter of another name. Repeatable.",
            show_default="as the file says",
        ),
    ] = None,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    speed: Annotated[
        str,
        typer.Option(metavar="FACTOR", help="As of run; max judges losses alone, not times."),
    ] = "1",
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", min=0.0, help="Run so long.", show_default="until the sources end"
        ),
    ] = None,
    out: Out = Path("out"),
    as_json: AsJson = False,
) -> None:
    """Run a graph and check it against its `expect` block. Exit code 1: something was not met."""
    factor = parse_speed(speed)
    from tools.check import check_file

    well = check_file(
        graph,
        on=on or (),
        settings=settings or (),
        overlays=overlays or (),
        models=models or (),
        speed=factor,
        duration_s=duration,
        out=out,
        as_json=as_json,
    )
    if not well:
        raise typer.Exit(RUN_FAILED)
