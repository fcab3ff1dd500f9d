"""Makes and opens the stages of a graph, and closes them whatever happens."""

from __future__ import annotations

import contextlib
from collections.abc import Collection

from pipeline.errors import OverflightError
from pipeline.graph.catalog import Catalog
from pipeline.graph.graph import Graph
from pipeline.measuring.statistics import Statistics
from pipeline.stage import ModelStage, Stage


def open_stages(
    graph: Graph,
    catalog: Catalog,
    stack: contextlib.ExitStack,
    statistics: Statistics,
    without: Collection[str] = (),
) -> dict[str, Stage]:
    """Make and open every stage; each is closed when the stack unwinds, in reverse order."""
    stages: dict[str, Stage] = {}
    for planned in (stage for stage in graph.stages if stage.name not in without):
        stage = planned.make()
        if isinstance(stage, ModelStage) and planned.model is not None:
            stage.model = catalog.spec(planned.model)
        stack.callback(_close, planned.name, stage, statistics)
        try:
            with statistics.profiler.building(planned.name):
                stage.open()
        except OSError as error:
            raise OverflightError(f"stages.{planned.name}: does not open: {error}") from error
        stages[planned.name] = stage
    return stages


def _close(name: str, stage: Stage, statistics: Statistics) -> None:
    """Close a stage; a failure to do so must not keep the others open."""
    try:
        stage.close()
    except Exception as error:
        statistics.failures.append(f"{name}: close failed: {type(error).__name__}: {error}")
