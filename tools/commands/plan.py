"""The words of `overflight plan`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tools.commands.app import RUN_FAILED, app, examples
from tools.commands.options import AsJson, GraphFile, ModelFiles, Overlays, Settings


@app.command(
    epilog=examples(
        "overflight profile graphs/emulated_uav.yaml --save-costs costs.yaml",
        "overflight plan graphs/emulated_uav.yaml --costs costs.yaml --picture schedule.svg",
        "overflight plan uav.yaml --max-cpu 1.5 --min-rate semantic_map=9 --json",
    )
)
def plan(
    graph: GraphFile,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    costs: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="What each step costs: of overflight profile --save-costs.",
            show_default="the latencies in the file and the shipped ones",
        ),
    ] = None,
    seconds: Annotated[
        float,
        typer.Option(metavar="SECONDS", min=1.0, help="Virtual time of each assignment."),
    ] = 30.0,
    limit: Annotated[
        float,
        typer.Option(
            metavar="SECONDS", min=0.0, help="Real time for all of them. Ctrl-C stops earlier."
        ),
    ] = 60.0,
    cores: Annotated[
        int | None,
        typer.Option(
            metavar="N", min=1, help="Of the computer that flies.", show_default="the cost table's"
        ),
    ] = None,
    max_cpu: Annotated[
        float | None,
        typer.Option(
            metavar="CORES",
            min=0.0,
            help="Demand that the process takes no more.",
            show_default="the file's expect block",
        ),
    ] = None,
    min_rate: Annotated[
        list[str] | None,
        typer.Option(
            metavar="OUTPUT=HZ",
            help="Demand a rate of an output. Repeatable.",
            show_default="the file's expect block",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Another draw of all times.")] = 0,
    top: Annotated[
        int, typer.Option(metavar="N", min=1, help="How many assignments the table shows.")
    ] = 10,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Draw the schedule of the best assignment (.svg or .png).",
            show_default=False,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Predict rates, ages, losses and load for every assignment of stages to devices.

    Runs the real scheduler in virtual time; nothing is executed. Exit code 1: no assignment meets
    the demands.
    """
    from tools.planning.plan import plan_file

    met = plan_file(
        graph,
        settings=settings or (),
        overlays=overlays or (),
        models=models or (),
        costs=costs,
        seconds=seconds,
        limit_s=limit,
        cores=cores,
        max_cpu=max_cpu,
        min_rates=min_rate or (),
        seed=seed,
        top=top,
        picture=picture,
        as_json=as_json,
    )
    if not met:
        raise typer.Exit(RUN_FAILED)
