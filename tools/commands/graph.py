"""The words of `overflight graph`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tools.commands.app import app, emit, examples
from tools.commands.options import GraphFile, ModelFiles, Overlays, Settings


class Drawing(StrEnum):
    """The forms that `overflight graph` draws in."""

    MERMAID = "mermaid"
    DOT = "dot"
    SVG = "svg"


#: What a file's ending asks for; Mermaid stands in Markdown, too.
ENDINGS = {
    **{".svg": Drawing.SVG, ".dot": Drawing.DOT, ".gv": Drawing.DOT},
    **dict.fromkeys((".mermaid", ".mmd", ".md", ".txt", ""), Drawing.MERMAID),
}


@app.command(name="graph", epilog=examples("overflight graph graphs/drive.yaml -o drive.svg"))
def draw(
    graph: GraphFile,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    form: Annotated[
        Drawing | None,
        typer.Option(
            "--format", help="How to draw.", show_default="the ending of -o, else mermaid"
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE", help="Write to a file.", show_default="print"
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print stages and edges as JSON instead of a drawing.")
    ] = False,
) -> None:
    """Draw a graph: its stages, devices and edges."""
    from tools.drawing.diagram import Diagram
    from tools.load import open_graph

    loaded, _ = open_graph(graph, settings or (), overlays or (), models or ())
    diagram = Diagram.of(loaded)
    form = form or _form_of(output)
    if as_json:
        emit(diagram.json(), output)
    elif form is Drawing.SVG:
        from tools.drawing.svg import svg

        emit(svg(diagram), output)
    else:
        emit(diagram.dot() if form is Drawing.DOT else diagram.mermaid(), output)


def _form_of(output: Path | None) -> Drawing:
    """The form that the ending of the file asks for, Mermaid where there is no file."""
    ending = output.suffix.lower() if output is not None else ""
    if ending not in ENDINGS:
        known = ", ".join(filter(None, ENDINGS))
        raise typer.BadParameter(
            f"{output}: no drawing ends in {ending}; take {known}, or --format"
        )
    return ENDINGS[ending]
