"""Which stages of two readings of one graph file are not the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from pipeline.graph.graph import Graph, GraphStage


def changed_stages(a: Graph, b: Graph) -> list[GraphStage]:
    """The stages of `a` that are others in `b`, and all that get their messages."""
    others = {stage.name: stage for stage in b.stages}
    changed = {
        stage.name
        for stage in a.stages
        if stage.name in others and not _same_stage(a, stage, b, others[stage.name])
    }
    affected: list[GraphStage] = []
    # A stage may stand before its sources in the file, so go round until nothing is added.
    while True:
        for node in a.topology.stages:
            sources = {port.stage for entry in node.inputs for port in entry.sources}
            if node.name in others and sources & changed:
                changed.add(node.name)
        found = [stage for stage in a.stages if stage.name in changed]
        if len(found) == len(affected):
            return found
        affected = found


def _same_stage(a: Graph, one: GraphStage, b: Graph, other: GraphStage) -> bool:
    mine = [(name, a.devices[name].use, a.devices[name].options) for name in one.ladder]
    theirs = [(name, b.devices[name].use, b.devices[name].options) for name in other.ladder]
    return _same(
        (one.use, one.model, one.options, mine), (other.use, other.model, other.options, theirs)
    )


def _same(a: Any, b: Any) -> bool:
    """Whether two option values say the same; those without an own equality by their parts."""
    if type(a) is not type(b):
        return False
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(_same(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(_same, a, b))
    if is_dataclass(a):
        return all(_same(getattr(a, one.name), getattr(b, one.name)) for one in fields(a))
    if hasattr(a, "tobytes"):
        return bool(a.shape == b.shape and a.tobytes() == b.tobytes())
    return bool(a == b) or (hasattr(a, "__dict__") and _same(vars(a), vars(b)))
