"""The words of `overflight statistics`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tools.commands.app import app, examples
from tools.commands.options import AsJson


@app.command(
    epilog=examples(
        "overflight statistics flight.mcap",
        "overflight statistics drives/06",
        "overflight statistics street.pcap --adapt semantickitti --name os0_on_network -o "
        "scan_statistics.yaml",
        "overflight statistics flight.osf --set remission=signal --scans 100 --json",
    )
)
def statistics(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="A flight (.mcap: its topic lidar, or --set topic=NAME), a drive of the KITTI "
            "family (a folder) or an Ouster file (.pcap, .osf, .bag).",
            show_default=False,
        ),
    ],
    source: Annotated[
        str | None,
        typer.Option(
            metavar="CLASS",
            help="The source that reads it: module:Class with an option `path`.",
            show_default="by the recording",
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Set one option of the source. Repeatable.",
            show_default=False,
        ),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="What the entry is called: the `sensor` of segment_scan.",
            show_default="the recording's name",
        ),
    ] = None,
    adapt: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Fit a network trained with this entry to the recording's sensor: z and remission "
            "are the recording's, range, x and y stay the network's.",
            show_default=False,
        ),
    ] = None,
    keep_remission: Annotated[
        bool,
        typer.Option(
            "--keep-remission",
            help="With --adapt: remission stays the network's too, for sensors that report the "
            "same material alike.",
        ),
    ] = False,
    rows: Annotated[
        int, typer.Option(metavar="N", min=1, help="Rows of the network's image.")
    ] = 64,
    columns: Annotated[
        int, typer.Option(metavar="N", min=1, help="Columns of the network's image.")
    ] = 512,
    elevation: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="LOWEST HIGHEST",
            help="The field of view of the image in degrees.",
            show_default="that of the first scan",
        ),
    ] = None,
    scans: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Only the first N scans.", show_default="all"),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Write the entry to a YAML file: the `statistics` of segment_scan. Its other "
            "entries stay.",
            show_default="only print",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure what a LiDAR network's input is normalized with; adapt a network to a sensor."""
    from tools.statistics import statistics_of

    statistics_of(
        recording,
        source=source,
        settings=settings or (),
        name=name,
        adapt=adapt,
        keep_remission=keep_remission,
        size=(rows, columns),
        elevation_deg=elevation,
        scans=scans,
        output=output,
        as_json=as_json,
    )
