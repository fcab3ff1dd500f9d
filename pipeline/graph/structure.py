"""Checks a graph as a whole: circles, stages that nothing reaches, select groups, unread
outputs."""

from __future__ import annotations

from collections.abc import Sequence
from graphlib import CycleError, TopologicalSorter

from pipeline.graph.report import Report
from pipeline.graph.wording import suggest
from pipeline.scheduling.topology import Input, Policy, Port, StageNode, Sync


def check_structure(nodes: Sequence[StageNode], report: Report) -> None:
    """Report what no single stage shows; `nodes` may lack stages that are wrong themselves."""
    circles = _circles(nodes)
    order = [node.name for node in nodes]
    for circle in circles:
        first = min(circle, key=order.index)
        turned = [*circle[circle.index(first) :], *circle[: circle.index(first) + 1]]
        what = f"stages wait for each other in a circle: {' -> '.join(turned)}; one edge must go"
        report.mistake(("stages", first, "inputs"), what)
    _check_reach(nodes, {name for circle in circles for name in circle}, report)
    _check_select_groups(nodes, report)
    _check_wanted(nodes, report)
    _warn_unread(nodes, report)


def in_order(nodes: Sequence[StageNode]) -> list[StageNode]:
    """The stages of a graph without circles, each after those it reads."""
    by_name = {node.name: node for node in nodes}
    return [by_name[name] for name in TopologicalSorter(_feeders(nodes)).static_order()]


def _feeders(nodes: Sequence[StageNode]) -> dict[str, set[str]]:
    known = {node.name for node in nodes}
    return {
        node.name: {edge.stage for entry in node.inputs for edge in entry.sources} & known
        for node in nodes
    }


def _circles(nodes: Sequence[StageNode]) -> list[list[str]]:
    """Circles in the direction of the messages, one for each edge that would have to go."""
    feeders = _feeders(nodes)
    circles: list[list[str]] = []
    while True:
        try:
            TopologicalSorter(feeders).prepare()
            return circles
        except CycleError as error:
            circle: list[str] = error.args[1][:-1]  # each feeds the next
            circles.append(circle)
            feeders[circle[0]].remove(circle[-1])


def _check_reach(nodes: Sequence[StageNode], in_circle: set[str], report: Report) -> None:
    """A stage lives if the chain of triggers above it ends in a source."""
    feeder = {node.name: _trigger_stage(node) for node in nodes}
    for node in nodes:
        seen: set[str] = set()
        above: str | None = node.name
        while above is not None and above not in seen:
            seen.add(above)
            above = feeder.get(above)  # None: a source, or a stage whose own mistake is reported
        if above is not None and node.name not in in_circle:
            what = f"no source reaches it: its trigger comes from the circle of '{above}'"
            report.mistake(("stages", node.name), what)


def _trigger_stage(node: StageNode) -> str | None:
    triggers = [entry for entry in node.inputs if entry.sync is Sync.TRIGGER]
    return triggers[0].sources[0].stage if len(triggers) == 1 and triggers[0].sources else None


def _check_select_groups(nodes: Sequence[StageNode], report: Report) -> None:
    groups: dict[tuple[Port, str], list[tuple[str, Input]]] = {}
    wanted = {node.name: node.wanted for node in nodes}
    for node in nodes:
        for entry in node.inputs:
            if entry.select is not None and entry.sync is Sync.TRIGGER and entry.sources:
                groups.setdefault((entry.sources[0], entry.select), []).append((node.name, entry))
    for (port, word), members in groups.items():
        first_stage, first = members[0]
        for stage, entry in members[1:]:
            if entry.period != first.period:
                what = f"shares select '{word}' with '{first_stage}', so both need the same rate_hz"
                report.mistake(("stages", stage, "inputs", entry.name), what)
            if wanted[stage] != wanted[first_stage]:
                what = f"shares select '{word}' with '{first_stage}', so both need the same 'run'"
                report.mistake(("stages", stage), what)
        if len(members) == 1:
            others = [select for other, select in groups if other == port and select != word]
            what = f"no other input on {port} has the select '{word}'"
            what += suggest(word, others, or_list=False)
            report.warn(("stages", first_stage, "inputs", first.name, "select"), what)


def _check_wanted(nodes: Sequence[StageNode], report: Report) -> None:
    """Wanted frames need a queue that may pass frames over, and somebody who chooses."""
    for node in nodes:
        triggers = [entry for entry in node.inputs if entry.sync is Sync.TRIGGER]
        if not node.wanted or not triggers:
            continue
        if triggers[0].policy is not Policy.LATEST:
            what = "'run: wanted' passes frames over, so its queue is latest"
            what += f", not {triggers[0].policy}"
            report.mistake(("stages", node.name, "run"), what)
        outputs = {Port(node.name, name) for name in node.outputs}
        choosy = any(
            outputs & set(entry.sources) and (other.wanted or entry.sync is not Sync.TRIGGER)
            for other in nodes
            for entry in other.inputs
        )
        if not choosy:
            what = (
                "nobody downstream chooses among its results, so 'run: wanted' runs on every frame"
            )
            report.warn(("stages", node.name, "run"), what)


def _warn_unread(nodes: Sequence[StageNode], report: Report) -> None:
    read = {edge for node in nodes for entry in node.inputs for edge in entry.sources}
    for node in nodes:
        for name in node.outputs:
            if (port := Port(node.name, name)) not in read:
                report.warn(("stages", node.name), f"nobody reads its output {port}")
