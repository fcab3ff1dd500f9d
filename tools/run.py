"""`overflight run`: a graph file from the first message to the report."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import typer
from rich.console import Console

from pipeline.drivers.run import run_graph
from pipeline.graph.graph import Graph
from pipeline.graph.placing import HERE
from pipeline.measuring.board import Board
from pipeline.measuring.expectations import failed, verdicts
from pipeline.measuring.trace import CAPACITY, Trace
from pipeline.processes.supervisor import Supervisor
from pipeline.recording.flight import Flight
from pipeline.recording.mcap import Compression
from pipeline.scheduling.partition import MAIN
from tools.check import verdict_table
from tools.part_process import MODULE as PART_MODULE
from tools.part_process import opening
from tools.recording.flight_graph import GraphFiles, on_flight
from tools.recording.record import SOURCES, chosen, recording
from tools.validate import print_warnings
from tools.watching.progress import Progress
from tools.watching.report import print_report
from tools.watching.trace import write_trace


def run_file(
    path: Path,
    *,
    flight: Path | None = None,
    settings: Sequence[str] = (),
    overlays: Sequence[Path] = (),
    models: Sequence[Path] = (),
    speed: float | None = 1.0,
    duration_s: float | None = None,
    out: Path = Path("out"),
    report: Path | None = None,
    trace: Path | None = None,
    trace_entries: int = CAPACITY,
    record: Path | None = None,
    record_edges: Sequence[str] = (),
    record_compression: Compression = "lz4",
    host: str | None = None,
    as_json: bool = False,
    quiet: bool = False,
) -> Sequence[str]:
    """Run it, tell of it, and return what failed or is not as the file expects (empty: all well).

    With a `flight` its messages take the place of the sources; where that is `path` itself, the
    graph is the flight's own.
    Progress and warnings go to stderr; the table, or with `as_json` the report, to stdout.
    """
    given = GraphFiles(path, settings, overlays, models, out)
    graph, catalog = given.open() if flight is None else on_flight(given, Flight(flight))
    if not quiet:
        print_warnings(graph.warnings)
    if report is not None:
        make_room_for(report)
    if trace is not None:
        make_room_for(trace, "trace")
    if record is not None:
        make_room_for(record, "recording")
    alone = speed is None or flight is not None
    processes = places(graph, host, alone=alone)
    apart = not alone and (len(processes) > 1 or host is not None)
    if apart and trace is not None:
        raise typer.BadParameter(
            f"--trace draws one process, and this graph runs in {len(processes)} "
            f"({', '.join(processes)}); use --record, which `overflight explain` reads"
        )
    asked = None
    if apart and record is not None:
        ports = map(str, chosen(graph, record_edges or (SOURCES,)))
        asked = {"path": str(record), "edges": sorted(ports), "compression": record_compression}
    started = time.time()
    recorded = None if trace is None else Trace(trace_entries)
    try:
        with contextlib.ExitStack() as stack:
            progress = Progress(graph.topology, Console(stderr=True))
            recorder = None
            if record is not None and not apart:
                kept = recording(
                    record,
                    graph,
                    offline=speed is None,
                    edges=record_edges,
                    compression=record_compression,
                )
                recorder = stack.enter_context(kept)
            show = None if quiet else stack.enter_context(progress)
            board = _open_board(stack)
            if apart:
                assert speed is not None
                supervisor = Supervisor(
                    graph,
                    PART_MODULE,
                    opening(path, settings, overlays, models, out, asked),
                    speed=speed,
                    host=host,
                    board=board,
                    progress=show,
                )
                result = supervisor.run(duration_s)
            else:
                result = run_graph(
                    graph,
                    catalog,
                    speed=speed,
                    duration_s=duration_s,
                    progress=show,
                    trace=recorded,
                    board=board,
                    recorder=recorder,
                )
    finally:  # a run that ended badly is the one to look at
        if recorded is not None and trace is not None and recorded.recorded:
            if not quiet:
                typer.echo(f"Writing {trace} ...", err=True)
            write_trace(recorded, graph.topology, graph.name, trace)
    for event in result.events:
        _, newline, lines = event.text.partition("\n")
        if newline:  # a defect of ours or of the user's own stage: that one keeps its traceback
            typer.echo(lines, err=True)
    judged = verdicts(graph.expect, result.report)
    page = {**result.report, "expectations": [asdict(verdict) for verdict in judged]}
    text = json.dumps(page, indent=2)
    if report is not None:
        report.write_text(text + "\n")
    if as_json:
        typer.echo(text)
    elif not quiet:
        console = Console()
        print_report(result.report, console)
        if judged:
            console.print("\n", verdict_table(judged), sep="")
        files = [file for file in (report, trace, record) if file is not None and file.exists()]
        if apart and record is not None:
            files += sorted(record.parent.glob(f"{record.stem}.*{record.suffix}"))
        if written := [*_written(out, started), *files]:
            names = ", ".join(dict.fromkeys(map(str, written)))
            console.print(f"Written: {names}", highlight=False, soft_wrap=True)
        if recorded is not None:
            told = f"{trace} has {recorded.recorded - recorded.overwritten} entries"
            if recorded.overwritten:
                told += f"; {recorded.overwritten} older ones were overwritten (--trace-entries)"
            console.print(f"{told}. Open it at ui.perfetto.dev.", highlight=False, soft_wrap=True)
    return (*result.failures, *failed(judged))


def places(graph: Graph, host: str | None, *, alone: bool) -> Sequence[str]:
    """The processes that this command starts. Raises BadParameter where --host does not fit.

    `alone`: offline, and when a flight is replayed, all stages share one process; results do not
    depend on where they run.
    """
    hosts = dict.fromkeys(process.host for process in graph.processes.values())
    if host is not None and host not in hosts:
        known = ", ".join(hosts) if HERE not in hosts else "none: its processes name no host"
        raise typer.BadParameter(f"--host {host}: the graph's hosts are {known}")
    if host is None and len(hosts) > 1 and not alone:
        raise typer.BadParameter(
            f"this graph runs on {len(hosts)} hosts; say which one this is: "
            + " or ".join(f"--host {name}" for name in hosts)
        )
    return (MAIN,) if alone else graph.placement.processes(host)


def make_room_for(file: Path, what: str = "report") -> None:
    """Fail before the flight, not after it, where a file cannot be written."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise typer.BadParameter(f"no place for the {what} {file}: {error.strerror}") from None
    if file.is_dir() or not os.access(file if file.exists() else file.parent, os.W_OK):
        raise typer.BadParameter(f"the {what} {file} cannot be written there")


def _open_board(stack: contextlib.ExitStack) -> Board | None:
    """Where `overflight top` reads how the run stands; a run goes on without it."""
    try:
        return stack.enter_context(Board())
    except OSError as error:
        typer.echo(f"`overflight top` will not see this run: {error}", err=True)
        return None


def _written(folder: Path, since: float) -> Iterator[Path]:
    """The entries of a folder that were written after an instant; a folder of files counts once."""
    if not folder.is_dir():
        return
    for entry in sorted(folder.iterdir()):
        files = entry.rglob("*") if entry.is_dir() else (entry,)
        # A file's time comes from the kernel's coarse clock, which lags by some milliseconds.
        if any(file.stat().st_mtime >= since - 0.1 for file in files):
            yield entry
