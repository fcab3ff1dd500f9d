"""The words of `overflight top`."""

from __future__ import annotations

from typing import Annotated

import typer

from tools.commands.app import app, examples


@app.command(
    epilog=examples("overflight top", "overflight top uav", "overflight top 4711 --once --json")
)
def top(
    which: Annotated[
        str | None,
        typer.Argument(
            metavar="[GRAPH|PROCESS]",
            help="The name of a graph that runs, or its process id.",
            show_default="the one that runs",
        ),
    ] = None,
    once: Annotated[
        bool, typer.Option("--once", help="Print how it stands now, and leave.")
    ] = False,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print JSON: a line twice a second, with --once one page."),
    ] = False,
) -> None:
    """Watch a graph that runs in another shell: rates, CPU, queues, losses, ages, devices."""
    from tools.watching.top import watch

    watch(which, once=once, as_json=as_json)
