"""The words of `overflight devices`."""

from __future__ import annotations

from tools.commands.app import app, examples
from tools.commands.options import AsJson


@app.command(epilog=examples("overflight devices --json"))
def devices(as_json: AsJson = False) -> None:
    """List what this machine can run models on, and what to install for the rest."""
    from tools.devices import print_devices

    print_devices(as_json=as_json)
