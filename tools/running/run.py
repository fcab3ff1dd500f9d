"""`overflight run`: a graph file from the first message to the report."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import typer
from rich.console import Console

from pipeline.drivers.run import run_graph
from pipeline.measuring.board import Board
from pipeline.measuring.expectations import failed, verdicts
from pipeline.measuring.trace import CAPACITY
from pipeline.processes.supervisor import Supervisor
from pipeline.recording.mcap import Compression
from tools.recording.flight_graph import GraphFiles, on_flight
from tools.recording.record import recording
from tools.recording.several import flight_files, process_files
from tools.running.apart import opening, record_asked, runs_apart
from tools.running.part_process import MODULE
from tools.running.telling import Told
from tools.running.tracing import Tracing
from tools.validate import print_warnings
from tools.watching.progress import Progress


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
    graph, catalog = given.open() if flight is None else on_flight(given, flight)
    if not quiet:
        print_warnings(graph.warnings)
    for file, what in ((report, "report"), (trace, "trace"), (record, "recording")):
        if file is not None:
            make_room_for(file, what)
    apart = runs_apart(graph, host, alone=speed is None or flight is not None)
    started = time.time()
    tracing = None
    if trace is not None:
        tracing = Tracing(trace, trace_entries, graph, apart=apart, quiet=quiet)
    own_trace = None if tracing is None else tracing.own
    with contextlib.ExitStack() as stack:
        if tracing is not None:
            stack.enter_context(tracing)
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
            asked = None
            if record is not None:
                asked = record_asked(graph, record, record_edges, record_compression)
            supervisor = Supervisor(
                graph,
                MODULE,
                opening(given, asked, None if tracing is None else tracing.asked),
                speed=speed,
                host=host,
                board=board,
                progress=show,
                trace=own_trace,
            )
            result = supervisor.run(duration_s)
        else:
            result = run_graph(
                graph,
                catalog,
                speed=speed,
                duration_s=duration_s,
                progress=show,
                trace=own_trace,
                board=board,
                recorder=recorder,
            )
    told = Told(result, verdicts(graph.expect, result.report), as_json=as_json, quiet=quiet)
    told.defects()
    unwritten = [told.write(report) if report is not None else None]
    files = [file for file in (report, trace) if file is not None and file.exists()]
    if record is not None:
        written = process_files(record) if apart else flight_files(record)
        files += (file for file in written if _is_of(file, started))
    told.tables([*_written(out, started), *files])
    if tracing is not None:
        unwritten.append(tracing.failure)
        if not (as_json or quiet or tracing.failure):
            Console().print(tracing.told(), highlight=False, soft_wrap=True)
    return (*result.failures, *failed(told.judged), *filter(None, unwritten))


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
        if any(_is_of(file, since) for file in files):
            yield entry


def _is_of(file: Path, since: float) -> bool:
    """Whether it was written after an instant; a file's time comes from the kernel's coarse clock,
    which lags by some milliseconds."""
    return file.stat().st_mtime >= since - 0.1
