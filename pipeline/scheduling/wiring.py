"""Builds the scheduler's state from a topology: stages, ports, edges, slots, groups, devices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pipeline.message import Message
from pipeline.scheduling.bounds import OutputPort
from pipeline.scheduling.devices import Device
from pipeline.scheduling.edges import Edge
from pipeline.scheduling.events import Reason
from pipeline.scheduling.queue import TriggerQueue
from pipeline.scheduling.stages import SelectGroup, StageState
from pipeline.scheduling.sync import Slot, Synchronizer
from pipeline.scheduling.topology import Missing, Policy, Port, Role, StageNode, Sync, Topology
from pipeline.scheduling.wanted import MustWish, Need, Rhythm, Wishes

#: Told of a message that ends unused on an edge.
OnDrop = Callable[[Edge, Message[Any], Reason], None]


@dataclass(slots=True)
class Wiring:
    """The state of a whole graph."""

    stages: list[StageState] = field(default_factory=list)
    ports: dict[Port, OutputPort] = field(default_factory=dict)
    devices: dict[str, Device] = field(default_factory=dict)


def wire(topology: Topology, on_drop: OnDrop, *, offline: bool) -> Wiring:
    """The initial state of a graph."""
    wiring = Wiring()
    for index, node in enumerate(topology.stages):
        stage = StageState(index, node)
        wiring.stages.append(_stage(wiring, stage, node, topology.check_every))
    groups: dict[tuple[Port, str], SelectGroup] = {}
    for stage in wiring.stages:
        if stage.node.inputs:
            _connect(wiring, stage, groups, on_drop, offline)
    for stage in wiring.stages:
        stage.blocking = [
            edge
            for port in stage.ports
            for edge in port.edges
            if edge.slot is None and edge.input.policy is Policy.BLOCK and not offline
        ]
    _watch(wiring.stages)
    _wish(wiring.stages)
    return wiring


def _stage(wiring: Wiring, stage: StageState, node: StageNode, check_every: int) -> StageState:
    for name in node.outputs:
        output = OutputPort(Port(node.name, name), node.min_period)
        stage.ports.append(output)
        wiring.ports[output.port] = output
    for name in node.devices:
        device = wiring.devices.setdefault(name, Device(name, check_every))
        device.stages.append(stage)
        stage.ladder.append(device)
    stage.stand()
    return stage


def _connect(
    wiring: Wiring,
    stage: StageState,
    groups: dict[tuple[Port, str], SelectGroup],
    on_drop: OnDrop,
    offline: bool,
) -> None:
    """Connect a stage's inputs to the ports they read."""
    rules = stage.node.inputs
    stage.queue = TriggerQueue(stage.node.trigger, lossless=offline)
    edges_of: dict[int, Edge] = {}  #: by slot identity

    def slot_dropped(slot: Slot, message: Message[Any], reason: Reason) -> None:
        on_drop(edges_of[id(slot)], message, reason)

    if any(rule.sync is not Sync.TRIGGER for rule in rules):
        stage.sync = Synchronizer(rules, slot_dropped, offline=offline)
    slots = iter(stage.sync.slots if stage.sync else ())
    for rule in rules:
        edges = []
        for source in rule.sources:
            edge = Edge(wiring.ports[source], stage, rule)
            edge.origin.edges.append(edge)
            edges.append(edge)
            if rule.sync is not Sync.TRIGGER:
                edge.slot = next(slots)
                edges_of[id(edge.slot)] = edge
                stage.synced_edges.append(edge)
                continue
            stage.producer = edge
            if rule.select is not None and not offline:
                stage.group = groups.setdefault((source, rule.select), SelectGroup())
                stage.group.members.append(stage)
        stage.inputs.append(edges)


def _watch(stages: list[StageState]) -> None:
    """Mark the stages whose bounds matter: a sync slot, a synchronised stage, or another process
    hears of them.

    All others skip the bookkeeping of bounds, which a long chain would pay on every hop.
    """
    changed = True
    while changed:
        changed = False
        for stage in stages:
            if stage.watched:
                continue
            stage.watched = stage.node.role is Role.SENDER or any(
                edge.slot is not None or edge.target.sync is not None or edge.target.watched
                for port in stage.ports
                for edge in port.edges
            )
            changed |= stage.watched


def _wish(stages: list[StageState]) -> None:
    """Let wishes travel up to the stages that run on wanted frames only."""
    by_name = {stage.node.name: stage for stage in stages}

    def root(stage: StageState) -> OutputPort:
        """The source port at the end of a stage's chain of triggers."""
        while stage.producer is not None:
            port = stage.producer.origin
            stage = by_name[port.port.stage]
        return port

    def needs(stage: StageState) -> tuple[Need, ...]:
        """The nearest slots without which a set of the stage is skipped.

        What another process sends may be a choice already, and says nothing of what may come.
        """
        found = []
        for edge in stage.synced_edges:
            rule, above = edge.input, by_name[edge.origin.port.stage]
            port = edge.origin if above.producer is None else root(above)
            remote = by_name[port.port.stage].node.role is Role.REMOTE
            if rule.sync is Sync.NEAREST and rule.missing is Missing.SKIP and not remote:
                port.rhythm = port.rhythm or Rhythm()
                found.append(Need(port.rhythm, rule.tolerance, rule.offset))
        return tuple(found)

    def collect(stage: StageState, wishes: Wishes) -> None:
        """Add what the inputs downstream of a stage wish of it."""
        for edge in [edge for port in stage.ports for edge in port.edges]:
            rule, origin = edge.input, root(edge.target)
            if rule.sync is Sync.SPAN:
                wishes.all = True
            elif rule.sync is Sync.TRIGGER and edge.target.node.wanted:
                collect(edge.target, wishes)
            elif rule.sync is Sync.TRIGGER or origin is root(stage):
                wishes.may = True
            else:
                origin.rhythm = origin.rhythm or Rhythm()
                needed = needs(edge.target)
                wish = MustWish(origin.rhythm, rule.sync, rule.tolerance, rule.offset, needed)
                if wish not in wishes.musts:
                    wishes.musts.append(wish)

    groups: dict[object, Wishes] = {}
    for stage in stages:
        if stage.node.wanted and stage.producer is not None:
            group = (stage.producer.origin.port, stage.node.trigger.select)
            key = stage.node.name if group[1] is None else group
            stage.wishes = groups.setdefault(key, Wishes())
            collect(stage, stage.wishes)
