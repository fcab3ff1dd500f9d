"""What goes wrong in a run, as its file's `faults` say, checked against the graph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf

from pipeline.graph.contract import Contract
from pipeline.graph.nodes import Steps
from pipeline.graph.report import Report
from pipeline.graph.spec import FaultsSpec, LinkFaultSpec, SourceFaultSpec, Spec
from pipeline.graph.wording import suggest
from pipeline.scheduling.partition import Placement, links_between
from pipeline.scheduling.topology import Port, StageNode, Topology
from pipeline.transport.bad_wire import WireFaults


@dataclass(frozen=True, slots=True)
class SourceFaults:
    """What goes wrong with a source; ns from the graph's first sample, None: never."""

    dies_at: int | None = None
    returns_at: int | None = None
    repeats_at: int | None = None
    jumps_at: int | None = None
    jumps_by: int = 0
    stalls_at: int | None = None
    stalls_for: int = 0


@dataclass(frozen=True, slots=True)
class GraphFaults:
    """All that goes wrong in a run, but for what emulated devices do by themselves."""

    sources: Mapping[str, SourceFaults] = field(default_factory=dict)
    kills: Mapping[str, Sequence[float]] = field(default_factory=dict)  #: by process, seconds
    links: Mapping[Port, WireFaults] = field(default_factory=dict)

    @property
    def between_processes(self) -> tuple[str, ...]:
        """What cannot go wrong where all stages share one process."""
        return (*self.kills, *map(str, self.links))


#: A key, the one that it needs, and whether it has to be earlier than that one.
_NEEDS = (
    ("returns_at_s", "dies_at_s"),
    ("jumps_at_s", "jumps_by_ms"),
    ("jumps_by_ms", "jumps_at_s"),
    ("stalls_at_s", "stalls_for_s"),
    ("stalls_for_s", "stalls_at_s"),
    ("restored_at_s", "cut_at_s"),
)
_FOLLOWS = (("returns_at_s", "dies_at_s"), ("restored_at_s", "cut_at_s"))


def check_faults(
    spec: FaultsSpec,
    contracts: Mapping[str, Contract | None],
    nodes: Sequence[StageNode],
    placement: Placement,
    report: Report,
) -> GraphFaults:
    """The faults, resolved; reports those of things that are not there.

    `contracts` are all stages that the file names, None where one is wrong.
    """
    sources = [name for name, contract in contracts.items() if contract and contract.is_source]
    for name, source in spec.sources.items():
        if name not in sources and contracts.get(name, ...) is not None:
            what = f"no source '{name}'{suggest(name, sources)}"
            report.mistake(("faults", "sources", name), what, at_key=True)
        _check_together(("faults", "sources", name), source, report)
    processes = placement.processes()
    for name in spec.processes:
        if name not in processes:
            what = f"no process '{name}'{suggest(name, processes)}"
            report.mistake(("faults", "processes", name), what, at_key=True)
    if spec.processes and len(processes) == 1:
        report.warn(("faults", "processes"), "the graph has one process, which nobody can kill")
    crossing = {link.port for link in links_between(Topology(tuple(nodes)), placement)}
    known = [str(port).removesuffix("/out") for port in crossing]
    unread = any(contract is None for contract in contracts.values())
    for name, link in spec.links.items():
        if _port(name) not in crossing and not unread:
            what = f"no other process reads '{name}'{suggest(name, known)}"
            report.mistake(("faults", "links", name), what, at_key=True)
        _check_together(("faults", "links", name), link, report)
    return GraphFaults(
        {name: _source(source) for name, source in spec.sources.items()},
        {name: sorted(process.killed_at_s) for name, process in spec.processes.items()},
        {_port(name): _wire(link, spec.seed) for name, link in spec.links.items()},
    )


def _check_together(steps: Steps, spec: Spec, report: Report) -> None:
    for key, other in _NEEDS:
        if getattr(spec, key, None) is not None and getattr(spec, other) is None:
            report.mistake((*steps, key), f"'{key}' needs a '{other}' beside it", at_key=True)
    for later, earlier in _FOLLOWS:
        end, start = getattr(spec, later, None), getattr(spec, earlier, None)
        if end is not None and start is not None and end <= start:
            what = f"has to be after {earlier}, {start:g}"
            report.mistake((*steps, later), what)


def _port(name: str) -> Port:
    stage, _, port = name.partition("/")
    return Port(stage, port or "out")


def _source(spec: SourceFaultSpec) -> SourceFaults:
    return SourceFaults(
        _ns(spec.dies_at_s),
        _ns(spec.returns_at_s),
        _ns(spec.repeats_at_s),
        _ns(spec.jumps_at_s),
        round((spec.jumps_by_ms or 0) * 1e6),
        _ns(spec.stalls_at_s),
        _ns(spec.stalls_for_s) or 0,
    )


def _wire(spec: LinkFaultSpec, seed: int) -> WireFaults:
    cut = inf if spec.cut_at_s is None else spec.cut_at_s
    restored = inf if spec.restored_at_s is None else spec.restored_at_s
    return WireFaults(cut, restored, (spec.delay_ms or 0) / 1e3, spec.drops or 0.0, seed)


def _ns(seconds: float | None) -> int | None:
    return None if seconds is None else round(seconds * 1e9)
