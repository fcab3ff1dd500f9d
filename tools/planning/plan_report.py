"""A plan for a person and for a program."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from pipeline.measuring.expectations import NO_LOSS
from tools.check import verdict_table
from tools.planning.plan_ranking import Option, Ranking, assignment, bottleneck


def print_plan(ranking: Ranking, console: Console, *, top: int, picture: Path | None) -> None:
    """The ranking, then the best assignment in detail."""
    best = ranking.options[0]
    done = f"{len(ranking.options)} of {ranking.count}" if ranking.skipped else f"{ranking.count}"
    many = "assignment" if ranking.count == 1 else "assignments"
    console.print(
        f"\n[bold]{ranking.graph.name}[/bold] predicted, nothing was run: {done} {many} of stages "
        f"to devices, {ranking.seconds:g} virtual s each, {ranking.cores} cores\n"
    )
    if ranking.skipped:
        console.print(
            f"{ranking.skipped} were skipped for lack of time, those whose busiest device has the "
            "most to do; allow more with --limit.\n",
            style="yellow",
        )
    if ranking.count > 1:
        console.print(_ranking(ranking, top))
        console.print(
            "Best first: where every output speaks, by the demands met, then age at p99 and then "
            "rate of the output that suffers most (5 % count as equal), then CPU. Age: p50 / p99 "
            "of the oldest sample. "
            f"{FILES}: as the file has it.\n",
            style="dim",
        )
    report = best.plan.report
    console.print(_outputs(report))
    console.print()
    console.print(_use(ranking, best))
    console.print(f"\n{bottleneck(ranking, best)}", highlight=False)
    if lost := losses(report):
        words = ", ".join(f"{count} {reason}" for reason, count in lost.items())
        console.print(f"Not used: {words}.", highlight=False)
    if best.verdicts:
        console.print("\n", verdict_table(best.verdicts), sep="")
    if not best.is_files:
        console.print("\nThe best in the file's words:", highlight=False)
        for stage, device in best.devices.items():
            if device != ranking.graph.stage(stage).ladder[0]:
                console.print(f"  --set stages.{stage}.executor={device}", highlight=False)
    for note in ranking.known.notes:
        console.print(f"\n{note}", style="dim", highlight=False, soft_wrap=True)
    if picture is not None:
        console.print(f"\nWritten: {picture}", highlight=False, soft_wrap=True)


FILES = "*"  #: marks the assignment that the file has


def plan_json(ranking: Ranking) -> str:
    """Everything as plain values."""
    page = {
        "graph": ranking.graph.name,
        "virtual_s": ranking.seconds,
        "cores": ranking.cores,
        "assignments": ranking.count,
        "skipped": ranking.skipped,
        "notes": list(ranking.known.notes),
        "ranking": [_option(ranking, option) for option in ranking.options],
    }
    return json.dumps(page, indent=2)


def losses(report: Mapping[str, Any]) -> Counter[str]:
    """Messages that were not used, by reason, over all edges; without the end of the run."""
    lost: Counter[str] = Counter()
    for book in report["edges"].values():
        lost.update({reason: n for reason, n in book["dropped"].items() if n and reason != "end"})
    return lost


def _option(ranking: Ranking, option: Option) -> dict[str, Any]:
    return {
        "devices": dict(option.devices),
        "is_files": option.is_files,
        "bottleneck": bottleneck(ranking, option),
        "expectations": [asdict(verdict) for verdict in option.verdicts],
        "lost": sum(n for why, n in losses(option.plan.report).items() if why not in NO_LOSS),
        "stages_busy": {name: round(share, 4) for name, share in option.plan.busy.items()},
        "report": option.plan.report,
    }


def _ranking(ranking: Ranking, top: int) -> Table:
    table = Table("", box=None, pad_edge=False, header_style="bold")
    table.add_column("assignment", overflow="fold")
    for port in ranking.ends:
        table.add_column(port.removesuffix("/out"), justify="right")
    table.add_column("busiest device", justify="right")
    table.add_column("CPU", justify="right")
    if any(option.verdicts for option in ranking.options):
        table.add_column("demands")
    shown = [one for place, one in enumerate(ranking.options) if place < top or one.is_files]
    for option in shown:
        place = ranking.options.index(option) + 1
        devices = option.plan.report["devices"]
        busiest = max(devices, key=lambda name: devices[name]["busy_fraction"], default=None)
        cells = [
            f"{place}{FILES if option.is_files else ''}",
            assignment(option.devices).replace("; ", "\n"),
            *(_end(option.plan.report["outputs"][port]) for port in ranking.ends),
            f"{busiest} {100 * devices[busiest]['busy_fraction']:.0f} %" if busiest else "-",
            f"{option.cores:.2f}",
        ]
        if option.verdicts:
            count = option.failed
            cells.append("[green]met[/]" if not count else f"[red]{count} not met[/]")
        table.add_row(*cells)
    return table


def _end(output: Mapping[str, Any]) -> str:
    ages = output["age_from_stamp_ms"] or {}
    if output["rate_hz"] is None or ages.get("p50") is None:
        return "nothing"
    return f"{output['rate_hz']:.2f} Hz\n{ages['p50']:.0f} / {ages['p99']:.0f} ms"


def _outputs(report: Mapping[str, Any]) -> Table:
    table = Table("output", box=None, pad_edge=False, header_style="bold")
    for column in ("rate", "age p50", "age p99", "longest gap"):
        table.add_column(column, justify="right")
    for port, output in report["outputs"].items():
        ages = output["age_from_stamp_ms"] or {}
        values = (output["rate_hz"], ages.get("p50"), ages.get("p99"), output["longest_gap_ms"])
        units = ("Hz", "ms", "ms", "ms")
        cells = [
            "-" if value is None else f"{value:.{2 if unit == 'Hz' else 0}f} {unit}"
            for value, unit in zip(values, units, strict=True)
        ]
        table.add_row(port.removesuffix("/out"), *cells)
    return table


def _use(ranking: Ranking, option: Option) -> Table:
    """Devices and cores, and who uses them."""
    report = option.plan.report
    table = Table("use of", box=None, pad_edge=False, header_style="bold")
    table.add_column("", justify="right")
    table.add_column("by")
    for name, device in report["devices"].items():
        users = _shares({one: used["busy_fraction"] for one, used in device["stages"].items()})
        table.add_row(name, f"{100 * device['busy_fraction']:.0f} %", users)
    cores = {
        name: sum(ms * page["runs"] for ms in page["cpu_ms"].values()) / 1e3 / ranking.seconds
        for name, page in report["stages"].items()
    }
    table.add_row("CPU", f"{option.cores:.2f} cores", _shares(cores))
    return table


def _shares(shares: Mapping[str, float]) -> str:
    ordered = sorted(shares.items(), key=lambda one: -one[1])
    return ", ".join(f"{name} {100 * share:.0f} %" for name, share in ordered if share >= 0.005)
