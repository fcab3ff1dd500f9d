"""`overflight run --as-recorded`: a flight decided again as it was, and held against its hashes.

Each process of a flight decided alone, from what its sensors and the other processes sent; so they
are replayed one after the other.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from pipeline.drivers.replay_run import replay_flight
from pipeline.recording.comparing import options_differ, surroundings_differ
from pipeline.recording.flight import Flight
from tools.recording.flight_graph import GraphFiles, own_graph, payload_codecs, without_faults
from tools.recording.record import machine, manifest_of
from tools.recording.several import schedules
from tools.versions import versions


def replay_flights(
    flights: Sequence[Path],
    graph_path: Path | None,
    *,
    settings: Sequence[str] = (),
    overlays: Sequence[Path] = (),
    models: Sequence[Path] = (),
    out: Path = Path("out"),
    feed: Sequence[str] = (),
    report: Path | None = None,
    as_json: bool = False,
    quiet: bool = False,
) -> Sequence[str]:
    """Re-enact the files of a flight with their own graph, or with the one of a file; returns what
    differs."""
    pages: dict[str, dict[str, Any]] = {}
    failures: list[str] = []
    fed = stages_fed(flights, feed)
    for path in flights:
        page, failed = _replay(
            path, graph_path, settings, overlays, models, out, fed[path], quiet=quiet
        )
        pages[path.name] = page
        failures += failed if len(flights) == 1 else (f"{path.name}: {one}" for one in failed)
        if not (as_json or quiet):
            console = Console()
            if len(flights) > 1:
                console.print(f"[bold]{path}[/bold]", highlight=False)
            print_replay(page["replay"], console)
    text = json.dumps(pages if len(pages) > 1 else next(iter(pages.values())), indent=2)
    if report is not None:
        report.write_text(text + "\n")
    if as_json:
        typer.echo(text)
    return failures


def stages_fed(flights: Sequence[Path], feed: Sequence[str]) -> dict[Path, list[str]]:
    """The stages of `feed` that each file scheduled; the first is asked for what none did, too."""
    fed = {path: [name for name in feed if schedules(path, name)] for path in flights}
    fed[flights[0]] += set(feed).difference(*fed.values())
    return fed


def _replay(
    flight_path: Path,
    graph_path: Path | None,
    settings: Sequence[str],
    overlays: Sequence[Path],
    models: Sequence[Path],
    out: Path,
    feed: Sequence[str],
    *,
    quiet: bool,
) -> tuple[dict[str, Any], Sequence[str]]:
    """The report of one file, and what is not as recorded."""
    flight = Flight(flight_path)
    recorded = flight.manifest
    with contextlib.ExitStack() as stack:
        path = graph_path or stack.enter_context(own_graph(flight, recorded.graph))
        files = GraphFiles(path, settings, overlays, models, out)
        graph, catalog = files.open()
        if faults := without_faults(graph):
            graph, catalog = files.open(*faults)
        progress = None if quiet else stack.enter_context(_progress(recorded.graph))
        result = replay_flight(
            graph, catalog, flight, payload_codecs(graph), feed=feed, progress=progress
        )
    replayed = graph.part(recorded.process)[0] if recorded.process else graph
    page = {**result.report}
    page["replay"] |= {
        "surroundings": surroundings_differ(recorded, _present(versions()), machine()),
        "options": options_differ(recorded, manifest_of(replayed, offline=recorded.offline)),
    }
    return page, result.failures


def print_replay(replay: Mapping[str, Any], console: Console) -> None:
    """What was repeated, and how well."""
    same = replay["decisions_identical"]
    verdict = "[green]identical[/green]" if same else "[red]different[/red]"
    cut = "" if replay["whole"] or not same else f" of {replay['events_recorded']:,}"
    console.print(f"Decisions: {replay['events']:,}{cut} events, {verdict}")
    compared, different = replay["outputs_compared"], replay["outputs_different"]
    verdict = f"[red]{different:,} different[/red]" if different else "[green]identical[/green]"
    console.print(f"Messages: {compared:,} compared by hash, {verdict}")
    if replay["outputs_not_compared"]:
        count = replay["outputs_not_compared"]
        console.print(
            f"{count:,} messages have no recorded hash: the recorder had no room for them"
        )
    for place in replay["first_different_outputs"]:
        console.print(f"  not as recorded: {place}", highlight=False)
    for stage, why in replay["fed"].items():
        line = f"{stage}: not executed, its recorded outputs were taken ({why})"
        console.print(line, style="yellow", highlight=False, soft_wrap=True)
    if replay["surroundings"]:
        console.print(
            "Not as in the flight, so that floating-point results may differ in their last bits: "
            + "; ".join(replay["surroundings"]),
            style="dim" if not different else "yellow",
            highlight=False,
        )
    for line in replay["options"]:
        console.print(f"another option: {line}", style="yellow", highlight=False, soft_wrap=True)


@contextlib.contextmanager
def _progress(name: str) -> Iterator[Any]:
    columns = (
        TextColumn(f"replaying {name}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("events"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("", total=None)

        def told(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        yield told


def _present(found: Mapping[str, str | None]) -> dict[str, str]:
    return {name: version for name, version in found.items() if version}
