"""Options that several commands take, and how their values are read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

GraphFile = Annotated[
    Path, typer.Argument(metavar="GRAPH", help="The graph file.", show_default=False)
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Set one value of the file, e.g. parameters.voxel_m=0.1. Paths in it are relative "
        "to the working folder. Repeatable.",
        show_default=False,
    ),
]
Overlays = Annotated[
    list[Path] | None,
    typer.Option(
        "--overlay",
        metavar="FILE",
        help="Merge this file over the graph file. Repeatable; the last one wins.",
        show_default=False,
    ),
]
ModelFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--models",
        metavar="FILE",
        help="A further model registry beside the shipped one. Repeatable.",
        show_default=False,
    ),
]
Out = Annotated[Path, typer.Option("--out", metavar="DIR", help="The folder that $out stands for.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]


def parse_speed(text: str) -> float | None:
    """A factor of real time, or None for "max": as fast as the machine can, offline."""
    if text == "max":
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed < float("inf"):
        raise typer.BadParameter(f"'{text}' is neither a number above 0 nor 'max'")
    return speed
