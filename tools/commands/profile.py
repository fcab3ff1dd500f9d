"""The words of `overflight profile`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tools.commands.app import RUN_FAILED, app, complain, examples
from tools.commands.options import AsJson, GraphFile, ModelFiles, Out, Overlays, Settings


@app.command(
    epilog=examples(
        "overflight profile graphs/emulated_uav.yaml --html profile.html",
        "overflight profile graphs/drive.yaml --sweep executor --sweep rate_hz=1,2,5,10,15 "
        "--plot load.svg",
        "overflight profile graph.yaml --sweep executor --save-costs costs.yaml",
    )
)
def profile(
    graph: GraphFile,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            metavar="WHAT",
            help="executor: each model alone on every device that can run it. rate_hz=1,2,5: at "
            "these input rates. overlay=a.yaml,b.yaml: the graph under each file. Repeatable.",
            show_default=False,
        ),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            min=1.0,
            help="Of the run, or of every run of a sweep. Ctrl-C stops earlier.",
            show_default="20, in a sweep 5",
        ),
    ] = None,
    out: Out = Path("out"),
    html: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write one page with tables and plots.", show_default=False
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Draw a sweep's CPU load over rate as SVG.", show_default=False
        ),
    ] = None,
    save_costs: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write what every step cost, for 'plan'.", show_default=False
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure what every stage costs in real time: CPU by part, waits, device time, age, losses."""
    from tools.profiling.profile import profile_file

    failures = profile_file(
        graph,
        settings=settings or (),
        overlays=overlays or (),
        models=models or (),
        sweep=sweep or (),
        duration_s=duration,
        out=out,
        html=html,
        plot=plot,
        costs=save_costs,
        as_json=as_json,
    )
    for failure in failures:
        complain(failure)
    if failures:
        raise typer.Exit(RUN_FAILED)
