"""`overflight validate`: every mistake and warning of a graph file, for a person or a program."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import typer

from pipeline.errors import GraphError, Mistake
from pipeline.graph.wording import numbered
from tools.load import open_graph


def validate_file(
    path: Path,
    *,
    settings: Sequence[str] = (),
    overlays: Sequence[Path] = (),
    models: Sequence[Path] = (),
    out: Path = Path("out"),
    as_json: bool = False,
) -> bool:
    """Print what is wrong and whether the file can run; True when it can."""
    mistakes: Sequence[Mistake] = ()
    warnings: Sequence[Mistake] = ()
    try:
        graph, _ = open_graph(path, settings, overlays, models, out)
        warnings = graph.warnings
    except GraphError as error:
        mistakes = error.mistakes
    if as_json:
        found = {
            "valid": not mistakes,
            "mistakes": [asdict(mistake) for mistake in mistakes],
            "warnings": [asdict(warning) for warning in warnings],
        }
        typer.echo(json.dumps(found, indent=2))
    elif mistakes:
        print_mistakes(mistakes)
    else:
        print_warnings(warnings)
        typer.echo(f"{path}: no mistakes, {numbered(len(warnings), 'warning')}")
    return not mistakes


def print_mistakes(mistakes: Sequence[Mistake]) -> None:
    """All of them in the order of the file, then their number, on stderr."""
    for mistake in mistakes:
        typer.secho(str(mistake), fg=typer.colors.RED, err=True)
    typer.echo(numbered(len(mistakes), "mistake"), err=True)


def print_warnings(warnings: Sequence[Mistake]) -> None:
    """One line each on stderr."""
    for warning in warnings:
        typer.secho(f"warning: {warning}", fg=typer.colors.YELLOW, err=True)
