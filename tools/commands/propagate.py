"""The words of `overflight propagate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tools.commands.app import INTERRUPTED, app, examples
from tools.commands.options import AsJson, ModelFiles, Settings
from tools.propagation.settings import GroundFix, Teacher


@app.command(
    epilog=examples(
        "overflight propagate flight.mcap -o labels",
        "overflight propagate drives/06 -o labels --from overlay",
        "overflight propagate flight.mcap -o labels --dynamic-within 2 --sound-only",
        "overflight train segment-scan --data labels",
    )
)
def propagate(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="A recorded flight (.mcap) or a drive of the KITTI family (a folder).",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="FOLDER",
            help="Becomes a sequence in SemanticKITTI's layout, with report.html beside it.",
        ),
    ] = Path("labels"),
    teacher: Annotated[
        Teacher,
        typer.Option(
            "--from",
            help="Who labels: the map of what the cameras said; each scan's own images; the map "
            "with the LiDAR network in it.",
        ),
    ] = Teacher.CAMERA_MAP,
    confidence: Annotated[
        float, typer.Option(metavar="P", min=0.0, max=1.0, help="Labels less sure are left out.")
    ] = 0.80,
    ground: Annotated[
        GroundFix,
        typer.Option(
            help="How the ground is known, on which only ground classes are kept: a plane per "
            "tile of 20 m, one plane, or not at all."
        ),
    ] = GroundFix.TILES,
    dynamic_window: Annotated[
        int | None,
        typer.Option(
            metavar="SCANS",
            min=0,
            max=15,
            help="Persons, vehicles and the like are labeled by the scans so near in time alone.",
            show_default="the whole recording",
        ),
    ] = None,
    dynamic_within: Annotated[
        int | None,
        typer.Option(
            metavar="SCANS",
            min=0,
            help="A label of what moves holds only where a scan so near in time saw it.",
            show_default="no limit",
        ),
    ] = None,
    sound_only: Annotated[
        bool,
        typer.Option("--sound-only", help="Leave out what was made while a device was degraded."),
    ] = False,
    voxel_m: Annotated[
        float, typer.Option(metavar="M", min=0.01, help="Edge of the map's voxels.")
    ] = 0.25,
    min_range_m: Annotated[
        float, typer.Option(metavar="M", min=0.0, help="Nearer points are the vehicle itself.")
    ] = 1.0,
    label_set: Annotated[
        str,
        typer.Option(metavar="SET", help="Whose ids to write: semantickitti, overflight, ..."),
    ] = "semantickitti",
    no_scans: Annotated[
        bool, typer.Option("--no-scans", help="Write the labels alone, not the scans too.")
    ] = False,
    pictures: Annotated[
        int, typer.Option(metavar="N", min=0, help="Scans that the report shows as panels.")
    ] = 4,
    observations: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="The FOLDER of another propagation of the recording, whose observations to use.",
            show_default="the output's",
        ),
    ] = None,
    graph: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="What observes the recording: a graph with a stage WriteObservations.",
            show_default="graphs/label_propagation.yaml or _drive.yaml",
        ),
    ] = None,
    settings: Settings = None,
    models: ModelFiles = None,
    as_json: AsJson = False,
) -> None:
    """Label the scans of a recording with what its cameras saw, by way of a map of all of it.

    The networks run once; what they said is kept in FOLDER/observations, so that the same command
    with other options takes seconds.
    """
    import json

    from rich.console import Console

    from stages.labeled_files import OWN, LabelSet
    from tools.propagation.observing import Order
    from tools.propagation.propagate import Product, plain, propagate
    from tools.propagation.report import print_report
    from tools.propagation.settings import Settings as Choices

    if dynamic_window is not None and dynamic_within is not None:
        raise typer.BadParameter("take one of --dynamic-window and --dynamic-within")
    if teacher is Teacher.OVERLAY and not (dynamic_window is dynamic_within is None):
        raise typer.BadParameter("each scan's own images have no window; take --from map")
    choices = Choices(
        teacher=teacher,
        confidence=confidence,
        voxel_m=voxel_m,
        ground=ground,
        min_range_m=min_range_m,
        dynamic_window=dynamic_window,
        dynamic_within=dynamic_within,
        sound_only=sound_only,
    )
    name = LabelSet.named(label_set).name
    product = Product(
        output, None if name == OWN else name, not no_scans, pictures, observed=observations
    )
    try:
        order = Order.of(recording, graph, models or (), settings or ())
        report = propagate(order, choices, product, Console(stderr=True))
    except KeyboardInterrupt:
        typer.echo("Stopped before all scans were observed; the command begins anew.", err=True)
        raise typer.Exit(INTERRUPTED) from None
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    if as_json:
        typer.echo(json.dumps(plain(report), indent=2))
        return
    print_report(report, Console())
    typer.echo(f"Written: {output} (report.html, labels/, velodyne/, observations/)")
