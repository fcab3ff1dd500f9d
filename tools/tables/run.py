"""`overflight evaluate --table`: make a table, show it, and leave it as files."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import typer
from rich.console import Console

from pipeline.errors import ModelError
from stages.sinks.whole_file import whole_file
from tools.commands.app import INTERRUPTED
from tools.tables.names import PaperFigure, PaperTable
from tools.tables.order import TableOrder
from tools.tables.table import Table

T = TypeVar("T")


def run_table(table: PaperTable, order: TableOrder, *, as_json: bool) -> None:
    """Make it, or go on making it. Raises OverflightError."""
    tables = _unless_stopped(order, lambda: _tables(table, order, Console(stderr=True)))
    _write(tables, order.output / f"table-{table.value}", as_json=as_json)


def _write(tables: Sequence[Table], target: Path, *, as_json: bool) -> None:
    """As Markdown and JSON, and shown."""
    told = json.dumps([one.told() for one in tables], indent=2)
    page = "\n".join(one.markdown() for one in tables)
    for ending, text in (("md", page), ("json", told)):
        with whole_file(target.with_suffix(f".{ending}")) as file:
            file.write(text.encode())
    if as_json:
        typer.echo(told)
        return
    for one in tables:
        one.show(Console())
    typer.echo(f"Written: {target}.md, .json")


def _tables(table: PaperTable, order: TableOrder, console: Console) -> list[Table]:
    if table is PaperTable.REAL:
        from tools.tables.real import RealOrder, real_table

        real = RealOrder(order.shared, order.output, seeds=order.seeds, threads=order.threads)
        if order.quick:
            real = replace(real, steps=100, seeds=1)
        if order.steps is not None:
            real = replace(real, steps=order.steps)
        return [real_table(real, console)]
    from tools.tables.ahead import train_ahead
    from tools.tables.experiment import Experiment
    from tools.tables.simulated import tables_of

    train_ahead(order, table.value, console)
    return tables_of(Experiment.of(order, console), table.value)


def run_figure(figure: PaperFigure, order: TableOrder) -> None:
    """Draw it, in the world of the tables. Raises OverflightError."""

    def draw() -> tuple[list[Path], Sequence[Table]]:
        from tools.tables.experiment import Experiment
        from tools.tables.figures import draw_figure

        console = Console(stderr=True)
        return draw_figure(int(figure.value), Experiment.of(order, console), console)

    written, tables = _unless_stopped(order, draw)
    if tables:
        _write(tables, written[0].parent / f"figure-{figure.value}", as_json=False)
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
