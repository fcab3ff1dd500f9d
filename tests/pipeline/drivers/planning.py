"""Graphs without classes, for the tests of plans."""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType
from typing import Any

from pipeline.graph.graph import Graph
from pipeline.graph.spec import ExpectSpec
from pipeline.measuring.costs import Costs
from pipeline.scheduling.topology import Input, Port, StageNode, Topology

NOTHING: MappingProxyType[str, Any] = MappingProxyType({})


def graph(*stages: StageNode, workers: int = 2) -> Graph:
    """What a plan takes of a graph: its topology."""
    topology = Topology(stages, workers)
    return Graph(
        name="test",
        file=Path("test.yaml"),
        stages=(),
        devices=NOTHING,
        models=NOTHING,
        topology=topology,
        parameters=NOTHING,
        expect=ExpectSpec(),
        warnings=(),
    )


def source(name: str) -> StageNode:
    return StageNode(name)


def stage(name: str, of: str, **settings: Any) -> StageNode:
    """A stage with one trigger."""
    rules = {key: settings.pop(key) for key in ("policy", "size") if key in settings}
    return StageNode(name, (Input("x", (Port(of),), **rules),), **settings)


def costs(period_ms: float, *entries: dict[str, Any], **sources: Any) -> Costs:
    """A table with a sensor `camera` that is stamped from 0 on, and these entries."""
    camera = {"camera": {"period_ms": period_ms, "phase_ms": 0}}
    return Costs.model_validate({"sources": {**camera, **sources}, "costs": entries})
