"""`overflight run`: a graph file from the first message to the report."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import typer
from rich.console import Console

from pipeline.drivers.run import run_graph
from tools.load import open_graph
from tools.progress import Progress
from tools.report import print_report
from tools.validate import print_warnings


def run_file(
    path: Path,
    *,
    settings: Sequence[str] = (),
    overlays: Sequence[Path] = (),
    models: Sequence[Path] = (),
    speed: float | None = 1.0,
    duration_s: float | None = None,
    out: Path = Path("out"),
    report: Path | None = None,
    as_json: bool = False,
    quiet: bool = False,
) -> Sequence[str]:
    """Run it, tell of it, and return what failed (empty when all is well).

    Progress and warnings go to stderr; the table, or with `as_json` the report, to stdout.
    """
    graph, catalog = open_graph(path, settings, overlays, models, out)
    if not quiet:
        print_warnings(graph.warnings)
    if report is not None:
        make_room_for(report)
    started = time.time()
    if quiet:
        result = run_graph(graph, catalog, speed=speed, duration_s=duration_s)
    else:
        with Progress(graph.topology, Console(stderr=True)) as progress:
            result = run_graph(
                graph, catalog, speed=speed, duration_s=duration_s, progress=progress
            )
    for event in result.events:
        _, newline, trace = event.text.partition("\n")
        if newline:  # a defect of ours or of the user's own stage: that one keeps its traceback
            typer.echo(trace, err=True)
    text = json.dumps(result.report, indent=2)
    if report is not None:
        report.write_text(text + "\n")
    if as_json:
        typer.echo(text)
    elif not quiet:
        console = Console()
        print_report(result.report, console)
        files = [*_written(out, started), *([report] if report is not None else [])]
        if files:
            names = ", ".join(dict.fromkeys(map(str, files)))
            console.print(f"Written: {names}", highlight=False, soft_wrap=True)
    return result.failures


def make_room_for(report: Path) -> None:
    """Fail before the flight, not after it, where the report cannot be written."""
    try:
        report.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise typer.BadParameter(f"no place for the report {report}: {error.strerror}") from None
    if report.is_dir() or not os.access(report if report.exists() else report.parent, os.W_OK):
        raise typer.BadParameter(f"the report {report} cannot be written there")


def _written(folder: Path, since: float) -> Iterator[Path]:
    """The entries of a folder that were written after an instant; a folder of files counts once."""
    if not folder.is_dir():
        return
    for entry in sorted(folder.iterdir()):
        files = entry.rglob("*") if entry.is_dir() else (entry,)
        # A file's time comes from the kernel's coarse clock, which lags by some milliseconds.
        if any(file.stat().st_mtime >= since - 0.1 for file in files):
            yield entry
