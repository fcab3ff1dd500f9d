"""`overflight run`: a graph file from the first message to the report."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import typer
from rich.console import Console

from pipeline.drivers.run import RunResult, run_graph
from pipeline.graph.graph import Graph
from pipeline.measuring.board import Board
from pipeline.measuring.expectations import failed, verdicts
from pipeline.measuring.trace import Trace
from pipeline.processes.supervisor import Supervisor
from tools.recording.flight_graph import on_flight
from tools.recording.record import recording
from tools.recording.several import flight_files, process_files
from tools.running.apart import opening, record_asked, runs_apart
from tools.running.order import RunOrder
from tools.running.part_process import MODULE
from tools.running.telling import Told
from tools.running.tracing import Tracing
from tools.validate import print_warnings
from tools.watching.progress import Progress


def run_file(order: RunOrder) -> Sequence[str]:
    """Run it, tell of it, and return what failed or is not as the file expects (empty: all well).

    Progress and warnings go to stderr; the table, or with `as_json` the report, to stdout.
    """
    if order.flight is None:
        graph, catalog = order.files.open()
    else:
        graph, catalog = on_flight(order.files, order.flight)
    if not order.quiet:
        print_warnings(graph.warnings)
    for file, what in _asked_files(order):
        make_room_for(file, what)
    apart = runs_apart(graph, order.host, alone=order.speed is None or order.flight is not None)
    started = time.time()
    with contextlib.ExitStack() as stack:
        tracing = None
        if (asked := order.trace) is not None:
            tracing = Tracing(asked.path, asked.entries, graph, apart=apart, quiet=order.quiet)
            stack.enter_context(tracing)
        recorder = None
        if order.record is not None and not apart:
            kept = recording(order.record, graph, offline=order.speed is None)
            recorder = stack.enter_context(kept)
        watching = _Watching.of(graph, order, tracing, stack)
        if apart:
            result = _run_apart(graph, order, watching)
        else:
            result = run_graph(
                graph,
                catalog,
                speed=order.speed,
                duration_s=order.duration_s,
                progress=watching.progress,
                trace=watching.trace,
                board=watching.board,
                recorder=recorder,
            )
    told = Told(
        result, verdicts(graph.expect, result.report), as_json=order.as_json, quiet=order.quiet
    )
    told.defects()
    unwritten = [told.write(order.report) if order.report is not None else None]
    told.tables([*_written(order.files.out, started), *_made(order, started, apart=apart)])
    if tracing is not None:
        unwritten.append(tracing.failure)
        if not (order.as_json or order.quiet or tracing.failure):
            Console().print(tracing.told(), highlight=False, soft_wrap=True)
    return (*result.failures, *failed(told.judged), *filter(None, unwritten))


@dataclass(frozen=True, slots=True)
class _Watching:
    """Who looks on while a run goes on."""

    progress: Progress | None
    board: Board | None
    tracing: Tracing | None

    @classmethod
    def of(
        cls,
        graph: Graph,
        order: RunOrder,
        tracing: Tracing | None,
        stack: contextlib.ExitStack,
    ) -> Self:
        progress = None
        if not order.quiet:
            progress = stack.enter_context(Progress(graph.topology, Console(stderr=True)))
        return cls(progress, _open_board(stack), tracing)

    @property
    def trace(self) -> Trace | None:
        """Of this process."""
        return None if self.tracing is None else self.tracing.own


def _run_apart(graph: Graph, order: RunOrder, watching: _Watching) -> RunResult:
    """In the processes that the graph names, each a child of this one."""
    assert order.speed is not None
    record = None if order.record is None else record_asked(graph, order.record)
    trace = None if watching.tracing is None else watching.tracing.asked
    supervisor = Supervisor(
        graph,
        MODULE,
        opening(order.files, record, trace),
        speed=order.speed,
        host=order.host,
        board=watching.board,
        progress=watching.progress,
        trace=watching.trace,
    )
    return supervisor.run(order.duration_s)


def _asked_files(order: RunOrder) -> Iterator[tuple[Path, str]]:
    """The files that a run is asked for, with what to call them."""
    if order.report is not None:
        yield order.report, "report"
    if order.trace is not None:
        yield order.trace.path, "trace"
    if order.record is not None:
        yield order.record.path, "recording"


def _made(order: RunOrder, since: float, *, apart: bool) -> Iterator[Path]:
    """Those of them that are there; of a recording in several files, those of this run."""
    for file, what in _asked_files(order):
        if what == "recording":
            files = process_files(file) if apart else flight_files(file)
            yield from (one for one in files if _is_of(one, since))
        elif file.exists():
            yield file


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
