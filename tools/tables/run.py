"""`overflight evaluate --table`: make a table, show it, and leave it as files."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import typer
from rich.console import Console

from pipeline.errors import ModelError
from stages.sinks.whole_file import whole_file
from tools.tables.names import PaperTable
from tools.tables.table import Table

INTERRUPTED = 130


@dataclass(frozen=True, slots=True)
class TableOrder:
    """What a person asked for."""

    table: PaperTable
    output: Path
    seeds: int
    steps: int | None
    quick: bool
    shared: Path
    threads: int


def run_table(order: TableOrder, *, as_json: bool) -> None:
    """Make it, or go on making it. Raises OverflightError."""
    try:
        from tools.train.loop import Interrupted
    except ImportError:
        raise ModelError("tables train networks: pip install 'overflight[train]'") from None
    console = Console(stderr=True)
    try:
        tables = _tables(order, console)
    except (Interrupted, KeyboardInterrupt):
        typer.echo(
            f"Stopped; what is done is in {order.output}. The same command goes on from there.",
            err=True,
        )
        raise typer.Exit(INTERRUPTED) from None
    name = f"table-{order.table.value}"
    told = json.dumps([table.told() for table in tables], indent=2)
    page = "\n".join(table.markdown() for table in tables)
    for ending, text in (("md", page), ("json", told)):
        with whole_file(order.output / f"{name}.{ending}") as file:
            file.write(text.encode())
    if as_json:
        typer.echo(told)
        return
    for table in tables:
        table.show(Console())
    typer.echo(f"Written: {order.output / name}.md, .json")


def _tables(order: TableOrder, console: Console) -> list[Table]:
    if order.table is PaperTable.REAL:
        from tools.tables.real import RealOrder, real_table

        real = RealOrder(order.shared, order.output, seeds=order.seeds, threads=order.threads)
        if order.quick:
            real = replace(real, steps=100, seeds=1)
        if order.steps is not None:
            real = replace(real, steps=order.steps)
        return [real_table(real, console)]
    from tools.tables.simulated import simulated_tables

    return simulated_tables(order, console)
