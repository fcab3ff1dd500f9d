"""Parts and variants of a graph for a sweep: one stage alone, on one device, at one input rate."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

from pipeline.errors import ModelError
from pipeline.graph.catalog import Catalog
from pipeline.graph.graph import Graph, GraphStage
from pipeline.scheduling.topology import StageNode, Sync


def alone(graph: Graph, stage: str) -> Graph:
    """The stage with all that feeds it, and nothing that waits for it."""
    nodes = {node.name: node for node in graph.topology.stages}
    kept: set[str] = set()
    todo = [stage]
    while todo:
        name = todo.pop()
        if name not in kept:
            kept.add(name)
            todo += [port.stage for entry in nodes[name].inputs for port in entry.sources]
    # Nobody downstream is left who could want a frame.
    return _with_node(_only(graph, kept), stage, lambda node: replace(node, wanted=False))


def on_device(graph: Graph, stage: str, device: str) -> Graph:
    """The stage on this device and no other."""
    stages = tuple(
        replace(one, ladder=(device,)) if one.name == stage else one for one in graph.stages
    )
    graph = replace(graph, stages=stages)
    return _with_node(graph, stage, lambda node: replace(node, devices=(device,)))


def at_rate(graph: Graph, stage: str, rate_hz: float) -> Graph:
    """The stage with a trigger of at most this rate, as `rate_hz` on its edge would do it."""
    period = round(1e9 / rate_hz)

    def slowed(node: StageNode) -> StageNode:
        inputs = (
            replace(entry, period=period) if entry.sync is Sync.TRIGGER else entry
            for entry in node.inputs
        )
        return replace(node, inputs=tuple(inputs))

    return _with_node(graph, stage, slowed)


def why_not(catalog: Catalog, graph: Graph, stage: GraphStage, device: str) -> str | None:
    """Why a device of the graph cannot run the stage's model, as a sentence; None when it can."""
    assert stage.model is not None
    try:
        return catalog.check(stage.model, graph.devices[device].make())
    except ModelError as error:
        return str(error)


def _only(graph: Graph, kept: Iterable[str]) -> Graph:
    kept = set(kept)
    topology = replace(
        graph.topology, stages=tuple(node for node in graph.topology.stages if node.name in kept)
    )
    stages = tuple(stage for stage in graph.stages if stage.name in kept)
    return replace(graph, stages=stages, topology=topology)


def _with_node(graph: Graph, name: str, change: Callable[[StageNode], StageNode]) -> Graph:
    nodes = (change(node) if node.name == name else node for node in graph.topology.stages)
    return replace(graph, topology=replace(graph.topology, stages=tuple(nodes)))
