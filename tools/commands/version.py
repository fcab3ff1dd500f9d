"""The words of `overflight version`."""

from __future__ import annotations

import json

import typer

from tools.commands.app import app
from tools.commands.options import AsJson


@app.command()
def version(as_json: AsJson = False) -> None:
    """Print the version; with --json also those of Python and the runtimes."""
    from tools.versions import own_version, versions

    typer.echo(json.dumps(versions(), indent=2) if as_json else f"overflight {own_version()}")
