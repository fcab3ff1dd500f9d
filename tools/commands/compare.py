"""The words of `overflight compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tools.commands.app import RUN_FAILED, app, complain, examples
from tools.commands.options import AsJson, GraphFile, ModelFiles, Out, Overlays, Settings


@app.command(
    epilog=examples(
        "overflight compare graphs/drive.yaml --b devices.ov.precision=bf16",
        "overflight compare graph.yaml --a stages.segment_rgb.executor=cpu --b "
        "stages.segment_rgb.executor=igpu",
    )
)
def compare(
    graph: GraphFile,
    a: Annotated[
        list[str] | None,
        typer.Option(
            "--a",
            metavar="KEY=VALUE",
            help="What one side sets, as --set does. Repeatable.",
            show_default="the file as it is",
        ),
    ] = None,
    b: Annotated[
        list[str] | None,
        typer.Option(
            "--b", metavar="KEY=VALUE", help="What the other side sets.", show_default=False
        ),
    ] = None,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            min=0.0,
            help="Compare so much of the recording. Ctrl-C stops without a result.",
            show_default="all of it",
        ),
    ] = None,
    out: Out = Path("out"),
    report: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write agreement and cost as JSON.", show_default=False),
    ] = None,
    as_json: AsJson = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="No progress and no tables; errors only.")
    ] = False,
) -> None:
    """Run one recording through two settings of a graph: do they agree, and what does each cost?

    Compares every stage that differs and all that follow; sinks write to a/ and b/ of --out.
    """
    from tools.comparing.compare import compare_file

    failures = compare_file(
        graph,
        settings=settings or (),
        a=a or (),
        b=b or (),
        overlays=overlays or (),
        models=models or (),
        duration_s=duration,
        out=out,
        report=report,
        as_json=as_json,
        quiet=quiet,
    )
    for failure in failures:
        complain(failure)
    if failures:
        raise typer.Exit(RUN_FAILED)
