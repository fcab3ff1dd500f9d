"""The words of `overflight stages`."""

from __future__ import annotations

import typer

from tools.commands.app import app
from tools.commands.options import AsJson


@app.command()
def stages(as_json: AsJson = False) -> None:
    """List the stage classes that ship."""
    from tools.show import stages_json, stages_text

    typer.echo(stages_json() if as_json else stages_text())
