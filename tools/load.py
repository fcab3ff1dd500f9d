"""Reads a graph file together with the models that it may name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from accelerators.registry import Registry
    from pipeline.graph.graph import Graph


def open_graph(
    path: Path,
    settings: Sequence[str] = (),
    overlays: Sequence[Path] = (),
    models: Sequence[Path] = (),
    out: Path = Path("out"),
) -> tuple[Graph, Registry]:
    """The checked graph and its catalog. Raises GraphError with every mistake, ModelError."""
    from accelerators.registry import Registry
    from pipeline.graph.graph import load_graph

    catalog = Registry.open(*models)
    graph = load_graph(path, catalog=catalog, overlays=overlays, settings=settings, out=out)
    return graph, catalog
