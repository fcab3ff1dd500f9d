"""The words of `overflight explain`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tools.commands.app import app, examples
from tools.commands.options import AsJson


@app.command(
    epilog=examples(
        "overflight explain flight.mcap --stage fuse_cloud",
        "overflight explain flight.mcap --stage fuse_cloud --at 12.3 --picture trigger.svg",
    )
)
def explain(
    flight: Annotated[
        Path,
        typer.Argument(
            metavar="FLIGHT",
            help="A file of `overflight run --record`; its decisions are enough.",
            show_default=False,
        ),
    ],
    stage: Annotated[str, typer.Option(metavar="NAME", help="Whose runs.", show_default=False)],
    at: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Only the trigger stamped nearest to this time from the beginning of the flight.",
            show_default=False,
        ),
    ] = None,
    all_triggers: Annotated[
        bool, typer.Option("--all", help="List every trigger, not only those that tell most.")
    ] = False,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Draw the time around the trigger as .svg or .png: --at, else the one that tells "
            "most.",
            show_default=False,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Tell why a stage ran when it did: each input's nearest message, its gap, the waiting.

    The scheduler itself is stepped through the recorded events; nothing is guessed.
    """
    if picture is not None and picture.suffix not in (".svg", ".png"):
        raise typer.BadParameter(f"--picture {picture}: end it in .svg or .png")
    from tools.recording.explain import explain_file

    explain_file(
        flight, stage, at_s=at, all_triggers=all_triggers, picture=picture, as_json=as_json
    )
