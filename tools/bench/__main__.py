"""`python -m tools.bench [NAME...]`: measures and prints what BENCHMARK.md keeps."""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from tools.bench import machine
from tools.bench.harness import Effort, Row

NAMES = (
    "hop",
    "chain",
    "sync",
    "scheduler",
    "emulated",
    "fanout",
    "wanted",
    "profiler",
    "kernels",
    "plan",
    "trace",
    "recording",
    "command",
    "transport",
)
#: Too long for a run of all: only by name.
LONG = ("transport_kills",)
HEAD = "| benchmark | figure | goal | measured | beside it, same run | ratio | met |"


def bench(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME]...",
            help=f"Of {', '.join(NAMES)}; all without names. Long: {', '.join(LONG)}.",
        ),
    ] = None,
    to: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the plain numbers there.")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Every row in a few seconds; no figure to rely on.")
    ] = False,
    seconds: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", min=1, help="How long `emulated` runs the graph: 60, quick 10."
        ),
    ] = None,
) -> None:
    """Measure the figures of BENCHMARK.md: medians, beside a floor or peer of the same run."""
    unknown = [name for name in names or () if name not in NAMES + LONG]
    if unknown:
        known = ", ".join(NAMES + LONG)
        raise typer.BadParameter(f"no benchmark '{unknown[0]}'; there are {known}")
    here = machine.describe()
    typer.echo(f"{machine.sentence(here)}{' Quick: no figure to rely on.' if quick else ''}\n")
    typer.echo(f"{HEAD}\n{'|---' * HEAD.count(' | ')}|---|")
    measured: dict[str, Sequence[Row]] = {}
    for name in names or NAMES:
        module = importlib.import_module(f"tools.bench.{name}")
        measured[name] = module.measure(Effort(quick, seconds))
        for line in lines(name, measured[name]):
            typer.echo(line)
    if to is not None:
        to.write_text(json.dumps(document(here, quick, measured), indent=2) + "\n")


def lines(name: str, rows: Sequence[Row]) -> Iterator[str]:
    """The rows as lines of a Markdown table."""
    words = {True: "yes", False: "**no**", None: ""}
    for row in rows:
        cells = [name, row.figure, row.goal, row.measured, row.beside, row.ratio, words[row.met]]
        yield "| " + " | ".join(cells) + " |"


def document(
    here: dict[str, Any], quick: bool, measured: dict[str, Sequence[Row]]
) -> dict[str, Any]:
    """Everything as plain values."""
    figures = {name: [asdict(row) for row in rows] for name, rows in measured.items()}
    return {"machine": here, "quick": quick, "benchmarks": figures}


if __name__ == "__main__":
    typer.run(bench)
