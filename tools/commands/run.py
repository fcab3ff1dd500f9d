"""The words of `overflight run`."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tools.commands.app import RUN_FAILED, app, complain, examples
from tools.commands.options import ModelFiles, Out, Overlays, Settings, parse_speed


class CompressionName(StrEnum):
    """How a recording is compressed."""

    LZ4 = "lz4"
    ZSTD = "zstd"
    NONE = "none"


@app.command(
    epilog=examples(
        "overflight run graphs/drive.yaml --set parameters.recording=my_drive --speed max "
        "--out out",
        "overflight run graphs/emulated_uav.yaml --duration 60 --record flight.mcap",
        "overflight run flight.mcap --as-recorded",
    )
)
def run(
    graph: Annotated[
        Path,
        typer.Argument(
            metavar="GRAPH|FLIGHT",
            help="The graph file, or a recorded flight, which brings its own.",
            show_default=False,
        ),
    ],
    flight: Annotated[
        Path | None,
        typer.Argument(
            metavar="FLIGHT",
            help="A recorded flight: its messages take the place of the graph's sources.",
            show_default=False,
        ),
    ] = None,
    as_recorded: Annotated[
        bool,
        typer.Option(
            "--as-recorded",
            help="Decide everything as in the flight, whatever this machine's speed, and compare "
            "each message with its recorded hash.",
        ),
    ] = False,
    feed: Annotated[
        list[str] | None,
        typer.Option(
            metavar="STAGE",
            help="With --as-recorded: do not execute this stage, take its recorded outputs. "
            "Repeatable.",
            show_default=False,
        ),
    ] = None,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    speed: Annotated[
        str,
        typer.Option(
            metavar="FACTOR",
            help="1: real time. 2: twice as fast. max: offline, nothing is dropped and every run "
            "gives the same result.",
        ),
    ] = "1",
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            min=0.0,
            help="Stop after so much time of the graph's clock. Ctrl-C stops earlier.",
            show_default="until the sources end",
        ),
    ] = None,
    out: Out = Path("out"),
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write rates, ages and losses as JSON.", show_default=False
        ),
    ] = None,
    trace: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write every run, wait, loss and decision as a Chrome trace, to look at in "
            "ui.perfetto.dev; FILE.gz is compressed.",
            show_default=False,
        ),
    ] = None,
    trace_entries: Annotated[
        int,
        typer.Option(
            metavar="COUNT", min=1, help="Keep so many entries of the trace, the last ones."
        ),
    ] = 200_000,
    record: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Record the run as an MCAP file, for Foxglove, Rerun, `overflight explain` and "
            "replay. Recording never holds the run back.",
            show_default=False,
        ),
    ] = None,
    record_edges: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAMES",
            help="Whose messages are written: stages, outputs (stage/port), 'sources' or 'all', "
            "with commas. Hashes and decisions are always written. Repeatable.",
            show_default="sources",
        ),
    ] = None,
    record_compression: Annotated[
        CompressionName,
        typer.Option(help="lz4 costs least CPU, zstd least disk."),
    ] = CompressionName.LZ4,
    host: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Run the part of a graph with `hosts` that this host has.",
            show_default=False,
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the report as JSON instead of a table.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="No progress and no table; errors only.")
    ] = False,
) -> None:
    """Run a graph until its sources end, --duration is over, or Ctrl-C.

    With a recorded flight its messages are the sources: as fast as they came, at --speed, or
    --as-recorded.
    """
    factor = parse_speed(speed)
    from tools.recording.flight_graph import GraphFiles
    from tools.recording.record import RecordOrder
    from tools.recording.several import flight_files
    from tools.running.order import RunOrder, TraceOrder
    from tools.running.run import run_file

    own = flight is None and bool(flight_files(graph))
    if as_recorded:
        flights = flight_files(flight or graph)
        if not flights:
            hint = "" if flight is not None else "; name one after it"
            raise typer.BadParameter(f"--as-recorded: {flight or graph} is no flight{hint}")
        for name, given in (("record", record), ("trace", trace), ("duration", duration)):
            if given is not None:
                raise typer.BadParameter(f"--{name} has no meaning with --as-recorded")
        from tools.recording.replay import replay_flights

        failures = replay_flights(
            flights,
            None if flight is None else graph,
            settings=settings or (),
            overlays=overlays or (),
            models=models or (),
            out=out,
            feed=feed or (),
            report=report,
            as_json=as_json,
            quiet=quiet,
        )
        _tell(failures)
        return
    order = RunOrder(
        files=GraphFiles(graph, settings or (), overlays or (), models or (), out),
        flight=graph if own else flight,
        speed=factor,
        duration_s=duration,
        report=report,
        trace=None if trace is None else TraceOrder(trace, trace_entries),
        record=None
        if record is None
        else RecordOrder(record, record_edges or (), record_compression.value),
        host=host,
        as_json=as_json,
        quiet=quiet,
    )
    _tell(run_file(order))


def _tell(failures: Sequence[str]) -> None:
    for failure in failures:
        complain(failure)
    if failures:
        raise typer.Exit(RUN_FAILED)
