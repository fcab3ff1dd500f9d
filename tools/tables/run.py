"""`overflight evaluate --table`: make a table, show it, and leave it as files."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import typer
from rich.console import Console

from pipeline.errors import ModelError
from stages.sinks.whole_file import whole_file
from tools.tables.names import PaperFigure, PaperTable
from tools.tables.order import TableOrder
from tools.tables.table import Table

INTERRUPTED = 130

T = TypeVar("T")


def run_table(table: PaperTable, order: TableOrder, *, as_json: bool) -> None:
    """Make it, or go on making it. Raises OverflightError."""
    tables = _unless_stopped(order, lambda: _tables(table, order, Console(stderr=True)))
    name = f"table-{table.value}"
    told = json.dumps([one.told() for one in tables], indent=2)
    page = "\n".join(one.markdown() for one in tables)
    for ending, text in (("md", page), ("json", told)):
        with whole_file(order.output / f"{name}.{ending}") as file:
            file.write(text.encode())
    if as_json:
        typer.echo(told)
        return
    for one in tables:
        one.show(Console())
    typer.echo(f"Written: {order.output / name}.md, .json")


def _tables(table: PaperTable, order: TableOrder, console: Console) -> list[Table]:
    if table is PaperTable.REAL:
        from tools.tables.real import RealOrder, real_table

        real = RealOrder(order.shared, order.output, seeds=order.seeds, threads=order.threads)
        if order.quick:
            real = replace(real, steps=100, seeds=1)
        if order.steps is not None:
            real = replace(real, steps=order.steps)
        return [real_table(real, console)]
    from tools.tables.simulated import simulated_tables

    return simulated_tables(table, order, console)


def run_figure(figure: PaperFigure, order: TableOrder) -> None:
    """Draw it, in the world of the tables. Raises OverflightError."""

    def draw() -> list[Path]:
        from tools.tables.figures import draw_figure
        from tools.tables.simulated import world_of

        console = Console(stderr=True)
        world, networks, _ = world_of(order, console)
        return draw_figure(int(figure.value), world, networks, console)

    written = _unless_stopped(order, draw)
    typer.echo("Written: " + ", ".join(map(str, written)))


def _unless_stopped(order: TableOrder, make: Callable[[], T]) -> T:
    """What is made; where Ctrl-C stops it, say how to go on."""
    try:
        from tools.train.loop import Interrupted
    except ImportError:
        raise ModelError("tables train networks: pip install 'overflight[train]'") from None
    try:
        return make()
    except (Interrupted, KeyboardInterrupt):
        typer.echo(
            f"Stopped; what is done is in {order.output}. The same command goes on from there.",
            err=True,
        )
        raise typer.Exit(INTERRUPTED) from None
