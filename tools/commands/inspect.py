"""The words of `overflight inspect`."""

from __future__ import annotations

from typing import Annotated

import typer

from tools.commands.app import app, examples
from tools.commands.options import AsJson


@app.command(epilog=examples("overflight inspect detect", "overflight inspect my_stages:MyStage"))
def inspect(
    stage: Annotated[
        str,
        typer.Argument(
            metavar="STAGE",
            help="module:Class as in a graph file, or the short name of a shipped stage.",
            show_default=False,
        ),
    ],
    as_json: AsJson = False,
) -> None:
    """Show a stage class: what it does, its ports, its options."""
    from tools.show import find_stage, stage_json, stage_text

    cls = find_stage(stage)
    typer.echo(stage_json(cls) if as_json else stage_text(cls))
