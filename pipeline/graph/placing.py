"""Which process and host each stage runs on, from the file's `process`, `processes` and `hosts`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pipeline.graph.contract import ContractError
from pipeline.graph.options import import_name
from pipeline.graph.report import Report
from pipeline.graph.spec import GraphSpec, HostSpec, ProcessSpec
from pipeline.graph.wording import suggest
from pipeline.scheduling.partition import MAIN, Placement
from pipeline.scheduling.topology import Port, StageNode, Sync
from pipeline.transport.channel import Compressor
from pipeline.transport.child import Restarts

#: The host of processes that name none.
HERE = "here"
_PORT = re.compile(r"^(?P<address>.*):(?P<port>[0-9]+)$")


@dataclass(frozen=True, slots=True)
class GraphProcess:
    """A process of the graph."""

    name: str
    host: str = HERE
    affinity: tuple[int, ...] | None = None
    nice: int = 0
    restarts: Restarts = field(default_factory=Restarts)


@dataclass(frozen=True, slots=True)
class GraphHost:
    """A host of the graph: where it is open to the others, and how they reach it."""

    name: str
    listen: tuple[str, ...] = ()
    reach: tuple[str, ...] = ()
    zenoh: Mapping[str, Any] = field(default_factory=dict)


def check_processes(
    spec: GraphSpec, nodes: Sequence[StageNode], report: Report
) -> tuple[Placement, Mapping[str, GraphProcess], Mapping[str, GraphHost]]:
    """The placement of the stages; reports what cannot be placed so."""
    process_of = {name: stage.process or MAIN for name, stage in spec.stages.items()}
    used = dict.fromkeys([*process_of.values(), *spec.processes])
    processes = {name: _process(name, spec.processes.get(name)) for name in used}
    hosts = {name: _host(name, host) for name, host in spec.hosts.items()}
    hosts.setdefault(HERE, GraphHost(HERE))
    for name, process in spec.processes.items():
        if name not in process_of.values():
            what = f"no stage has 'process: {name}'{suggest(name, process_of.values())}"
            report.warn(("processes", name), what)
        if process.host is not None and process.host not in spec.hosts:
            what = f"no host '{process.host}'{suggest(process.host, spec.hosts)}"
            report.mistake(("processes", name, "host"), what)
    for name, host in spec.hosts.items():
        for key, endpoints in (("listen", host.listen), ("reach", host.reach or ())):
            for i, endpoint in enumerate(endpoints):
                if not _PORT.match(endpoint) or "/" not in endpoint:
                    what = f"'{endpoint}' is no endpoint; write e.g. tcp/192.168.1.10:7447"
                    report.mistake(("hosts", name, key, i), what)
    _check_reach(spec, processes, report)
    _check_select(nodes, process_of, report)
    placement = Placement(process_of, {name: p.host for name, p in processes.items()})
    _check_compress(nodes, placement, report)
    return placement, processes, hosts


def numbered(endpoints: Sequence[str], index: int) -> tuple[str, ...]:
    """The endpoints of the n-th process of a host: each takes the next port."""
    found = []
    for endpoint in endpoints:
        if (match := _PORT.match(endpoint)) is not None:
            found.append(f"{match['address']}:{int(match['port']) + index}")
    return tuple(found)


def _process(name: str, spec: ProcessSpec | None) -> GraphProcess:
    if spec is None:
        return GraphProcess(name)
    restarts = Restarts(
        spec.restart_policy or "on-failure",
        5 if spec.max_restarts is None else spec.max_restarts,
        60.0 if spec.restart_window_s is None else spec.restart_window_s,
    )
    return GraphProcess(name, spec.host or HERE, spec.affinity, spec.nice or 0, restarts)


def _host(name: str, spec: HostSpec) -> GraphHost:
    return GraphHost(name, spec.listen, spec.reach or spec.listen, spec.zenoh)


def _check_reach(spec: GraphSpec, processes: Mapping[str, GraphProcess], report: Report) -> None:
    """Hosts that do not listen cannot find each other."""
    used = dict.fromkeys(process.host for process in processes.values())
    silent = [name for name in used if name in spec.hosts and not spec.hosts[name].listen]
    if HERE in used and len(used) > 1:
        names = [name for name, process in processes.items() if process.host == HERE]
        first = "stages" if names[0] not in spec.processes else "processes"
        what = (
            f"the graph has hosts, but process '{names[0]}' names none; give it one under "
            "processes, e.g. {host: " + next(name for name in used if name != HERE) + "}"
        )
        report.mistake((first, names[0]) if first == "processes" else ("processes",), what)
    if len(silent) > 1:
        what = f"neither '{silent[0]}' nor '{silent[1]}' listens, so they cannot find each other"
        report.mistake(("hosts", silent[1]), what)


def _check_select(
    nodes: Sequence[StageNode], process_of: Mapping[str, str], report: Report
) -> None:
    """A select group decides for all its members at one instant, so they share a process."""
    groups: dict[tuple[Port, str], str] = {}
    for node in nodes:
        for rule in node.inputs:
            if rule.select is None or rule.sync is not Sync.TRIGGER or not rule.sources:
                continue
            first = groups.setdefault((rule.sources[0], rule.select), node.name)
            if process_of[first] != process_of[node.name]:
                what = f"shares select '{rule.select}' with '{first}', so both need one process"
                report.mistake(("stages", node.name, "process"), what)


def compressor(name: str) -> Compressor:
    """The compressor of a ``module:Class``. Raises GraphError's ImportError or ContractError."""
    cls = import_name(name)
    if not (callable(getattr(cls, "shrink", None)) and callable(getattr(cls, "restore", None))):
        raise ContractError(f"{name} has no methods 'shrink' and 'restore'")
    made: Compressor = cls()
    return made


def _check_compress(nodes: Sequence[StageNode], placement: Placement, report: Report) -> None:
    """Compressing is for what goes to another host, and all readers there get the same."""
    seen: dict[tuple[Port, str], tuple[str, str | None]] = {}
    for node in nodes:
        process = placement.process_of[node.name]
        for rule in node.inputs:
            steps = ("stages", node.name, "inputs", rule.name, "compress")
            abroad = [
                port
                for port in rule.sources
                if placement.host_of[placement.process_of[port.stage]] != placement.host_of[process]
            ]
            if rule.compress is not None and not abroad:
                report.warn(
                    steps, "nothing of it comes from another host, so nothing is compressed"
                )
            elif rule.compress not in (None, "zstd"):
                try:
                    compressor(rule.compress)
                except (ImportError, ContractError) as error:
                    report.mistake(steps, str(error))
            for port in abroad:
                first, how = seen.setdefault(
                    (port, placement.host_of[process]), (node.name, rule.compress)
                )
                if how != rule.compress:
                    what = f"'{first}' reads {port} on the same host; both need the same compress"
                    report.mistake(("stages", node.name, "inputs", rule.name), what)
