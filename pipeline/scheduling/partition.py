"""Cuts a topology into the parts that different processes run.

A stage of another process becomes a *remote* node: a source of those of its ports that this part
reads. A port that other processes read gets a *sender*: a sink that takes its messages there, one
per port and host. What a part's scheduler decides is then decided by the same rules as in one
process: README.md, section 11.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from pipeline.scheduling.topology import (
    Input,
    OnError,
    Policy,
    Port,
    Role,
    StageNode,
    Sync,
    Topology,
)

#: What a sender holds while an earlier message is still being copied.
SENDER_QUEUE = 64
#: The process of stages that name none.
MAIN = "main"


@dataclass(frozen=True, slots=True)
class Placement:
    """Where the stages run: the process of each, and the host of each process."""

    process_of: Mapping[str, str]  #: by stage
    host_of: Mapping[str, str]  #: by process

    def processes(self, host: str | None = None) -> tuple[str, ...]:
        """Those that have a stage (on `host`), in the order of the stages."""
        used = dict.fromkeys(self.process_of.values())
        return tuple(name for name in used if host is None or self.host_of[name] == host)


NOWHERE = Placement(MappingProxyType({}), MappingProxyType({}))


@dataclass(frozen=True, slots=True)
class Link:
    """A port whose messages go from one process to others of one host."""

    port: Port
    origin: str  #: the process that makes them
    targets: tuple[str, ...]  #: the processes that read them
    host: str  #: of the targets
    local: bool  #: the origin is on that host, too
    window: int | None  #: ``policy: block``: sent and not yet taken at most; None: nobody waits
    waiting: tuple[str, ...] = ()  #: the targets that hold the origin back
    compress: str | None = None  #: to another host: ``zstd``, or a class as ``module:Class``

    @property
    def sender(self) -> str:
        """The name of the sender's node: no stage of a file can be called so."""
        return f"{self.port.stage}.{self.port.name}@{self.host}"


@dataclass(frozen=True, slots=True)
class Part:
    """What one process runs."""

    process: str
    topology: Topology
    outgoing: tuple[Link, ...] = ()
    incoming: tuple[Link, ...] = ()


def links_between(topology: Topology, placement: Placement) -> tuple[Link, ...]:
    """Every link of a graph, in the order of the file."""
    found: dict[tuple[Port, str], dict[str, list[Input]]] = {}
    for node in topology.stages:
        target = placement.process_of[node.name]
        for rule in node.inputs:
            for port in rule.sources:
                if placement.process_of[port.stage] != target:
                    there = found.setdefault((port, placement.host_of[target]), {})
                    there.setdefault(target, []).append(rule)
    return tuple(_link(port, host, there, placement) for (port, host), there in found.items())


def part_of(topology: Topology, placement: Placement, process: str) -> Part:
    """The part of a graph that `process` runs."""
    links = links_between(topology, placement)
    incoming = tuple(link for link in links if process in link.targets)
    outgoing = tuple(link for link in links if link.origin == process)
    nodes: list[StageNode] = []
    for node in topology.stages:
        ports = tuple(link.port.name for link in incoming if link.port.stage == node.name)
        if placement.process_of[node.name] == process:
            nodes.append(node)
        elif ports:
            nodes.append(StageNode(node.name, outputs=ports, role=Role.REMOTE))
    nodes += [_sender(link, _readers(link, topology, placement)) for link in outgoing]
    return Part(process, replace(topology, stages=tuple(nodes)), outgoing, incoming)


def _link(port: Port, host: str, there: Mapping[str, list[Input]], placement: Placement) -> Link:
    origin = placement.process_of[port.stage]
    windows = {target: _window(rules) for target, rules in there.items()}
    sizes = [size for size in windows.values() if size is not None]
    return Link(
        port,
        origin,
        tuple(there),
        host,
        placement.host_of[origin] == host,
        min(sizes, default=None),
        tuple(target for target, size in windows.items() if size is not None),
        next((rule.compress for rules in there.values() for rule in rules if rule.compress), None),
    )


def _readers(link: Link, topology: Topology, placement: Placement) -> list[Input]:
    return [
        rule
        for node in topology.stages
        if placement.process_of[node.name] in link.targets
        for rule in node.inputs
        if link.port in rule.sources
    ]


def _sender(link: Link, readers: Sequence[Input]) -> StageNode:
    """Inline and never dropping in practice; with a window a run lasts until it is taken there."""
    periods = [rule.period for rule in readers if rule.period is not None]
    waits = link.window is not None
    trigger = Input(
        "message",
        (link.port,),
        policy=Policy.BLOCK if waits else Policy.DROP_OLDEST,
        size=1 if waits else SENDER_QUEUE,
        period=min(periods) if len(periods) == len(readers) else None,
    )
    return StageNode(
        link.sender,
        (trigger,),
        max_in_flight=link.window or 1,
        inline=True,
        stateless=waits,
        on_error=OnError.SKIP,
        role=Role.SENDER,
    )


def _window(rules: Sequence[Input]) -> int | None:
    """The least room of the queues that may hold the producer back."""
    sizes = [r.size for r in rules if r.sync is Sync.TRIGGER and r.policy is Policy.BLOCK]
    return min(sizes, default=None)
