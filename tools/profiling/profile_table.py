"""A profile for a person: the table of stages, what the rest of the process took, the sweep."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table

from tools.profiling.profile_page import PARTS

EMULATED = "~"  #: before the name of what ran emulated
EMULATED_NOTE = (
    f"{EMULATED} emulated: device times are declared, and a driver's own CPU is not in it."
)


class Column(NamedTuple):
    """One figure of a point of a sweep: its head with the unit, and what stands in its cell."""

    head: str
    cell: Callable[[Mapping[str, Any]], str]


def print_profile(page: Mapping[str, Any], console: Console) -> None:
    """The stages of one run, and where all other CPU time went."""
    console.print(f"\n[bold]{page['graph']}[/bold], {page['wall_s']:.1f} s\n", highlight=False)
    stages = page["stages"]
    parts = [part for part in PARTS if any(part in row["cpu_ms"] for row in stages)]
    cost = _table("stage", "on", "Hz", "CPU %", *parts)
    for row in stages:
        cost.add_row(
            name(row),
            ", ".join(row["devices"]),
            number(row["rate_hz"], 1),
            number(row["cpu_percent"], 1),
            *(number(row["cpu_ms"].get(part), 2) for part in parts),
        )
    console.print(cost)
    console.print(
        "CPU: percent of one core; then the mean CPU ms of each step of a run.\n",
        style="dim",
        highlight=False,
    )
    times = _table("stage", "", "queued ms", "ran ms", "device busy %", "lost %", "age ms")
    for row in stages:
        if not row["source"]:
            times.add_row(
                name(row),
                "",
                both(row["queued_ms"]),
                both(row["ran_ms"]),
                number(row["busy_percent"], 0),
                number(100 * row["lost"] / max(row["lost"] + row["runs"], 1), 0),
                both(row["age_ms"]),
            )
    console.print(times)
    console.print(
        "p50/p99 of: trigger to start, start to end, oldest sensor sample to output.\n"
        "lost: triggers never used.",
        style="dim",
        highlight=False,
    )
    if any(row["emulated"] for row in stages):
        console.print(EMULATED_NOTE, style="dim", highlight=False)
    rest = _table("the rest of the process", "", "CPU %")
    for part, percent in page["rest_percent"].items():
        rest.add_row(part, "", number(percent, 2))
    rest.add_row("[bold]everything together", "", f"[bold]{number(page['process_percent'], 1)}")
    console.print()
    console.print(rest)
    if not page["attributed"]:
        threads = ", ".join(page["unknown_threads_percent"]) or "none that still live"
        console.print(
            f"More than 5 % is unattributed; threads that nobody owns: {threads}.", style="yellow"
        )


def print_sweep(points: Sequence[Mapping[str, Any]], console: Console) -> None:
    """One line per point, with the columns that say something."""
    ran = [point for point in points if not point["failed"]]
    shown = sweep_columns(ran)
    table = _table("variant", "on", *(column.head for column in shown))
    for point in ran:
        table.add_row(name(point), point["device"], *(column.cell(point) for column in shown))
    if ran:
        console.print(table)
    for point in points:
        if point["failed"]:
            text = f"not run: {why_not_run(point)}"
            console.print(text, style="yellow", highlight=False, soft_wrap=True)
    console.print(sweep_note(ran), style="dim", highlight=False)
    if any(point["emulated"] for point in points):
        console.print(EMULATED_NOTE, style="dim", highlight=False)


def sweep_columns(ran: Sequence[Mapping[str, Any]]) -> list[Column]:
    """The figures of a sweep's points, those that any of them has."""
    columns = (
        Column("asked Hz", lambda point: number(point["wanted_hz"], 1)),
        Column("Hz", lambda point: number(point["rate_hz"], 2)),
        Column("CPU %", lambda point: number(point["cpu_percent"], 2)),
        Column("CPU ms", lambda point: number(point["cpu_ms"], 2)),
        Column("infer ms", lambda point: both(point["infer_ms"])),
        Column("age ms", lambda point: both(point["age_ms"])),
    )
    return [column for column in columns if any(map(column.cell, ran))]


def why_not_run(point: Mapping[str, Any]) -> str:
    """What failed of a sweep, where, and why."""
    return f"{name(point)} on {point['device'] or 'its devices'}: {point['failed']}"


def sweep_note(ran: Sequence[Mapping[str, Any]]) -> str:
    """What the columns of a sweep are."""
    note = "CPU: percent of a core, and ms of a run. Times: p50/p99."
    if any(point["stage"] is None for point in ran):
        note += " Hz and age: of the slowest and oldest output; without the sensors."
    return note


def both(quantiles: Mapping[str, float | None] | None) -> str:
    """``53/106``: p50 and p99, with a digit below ten."""
    if not quantiles or quantiles["p50"] is None:
        return ""
    return "/".join(
        f"{ms:.1f}" if ms < 9.95 else f"{ms:.0f}" for ms in quantiles.values() if ms is not None
    )


def number(value: float | None, digits: int) -> str:
    """Nothing for nothing."""
    return "" if value is None else f"{value:.{digits}f}"


def name(row: Mapping[str, Any]) -> str:
    """Of a stage or a variant, marked where it ran emulated."""
    return f"{EMULATED if row['emulated'] else ''}{row.get('variant') or row['stage']}"


def _table(*columns: str) -> Table:
    """The first two columns are words, the others figures."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column(columns[0], no_wrap=True)
    table.add_column(columns[1])
    for column in columns[2:]:
        table.add_column(column, justify="right", no_wrap=True)
    return table
