"""A graph file, checked and resolved: what a driver runs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pipeline.errors import Mistake
from pipeline.graph.binding import check_binding
from pipeline.graph.catalog import Catalog
from pipeline.graph.contract import Contract
from pipeline.graph.expect import check_expect
from pipeline.graph.faults import GraphFaults, check_faults
from pipeline.graph.load import load_tree
from pipeline.graph.nodes import Mark, Node
from pipeline.graph.parameters import resolve_parameters
from pipeline.graph.parts import Part as ClassPart
from pipeline.graph.parts import PartMaker, StagePart
from pipeline.graph.placing import GraphHost, GraphProcess, check_processes
from pipeline.graph.report import Report
from pipeline.graph.shape import check_shape
from pipeline.graph.spec import DeviceSpec, ExpectSpec, StageSpec
from pipeline.graph.structure import check_structure
from pipeline.graph.timing import check_timing
from pipeline.graph.wiring import Wirer
from pipeline.graph.written import Written
from pipeline.model import Accelerator, ModelSpec
from pipeline.scheduling.partition import NOWHERE, Part, Placement, part_of
from pipeline.scheduling.topology import Input, OnError, StageNode, Topology
from pipeline.stage import Source, Stage
from pipeline.transport.child import Restarts


@dataclass(frozen=True, slots=True)
class GraphStage:
    """A stage of the file: its class, and all that is needed to make one."""

    name: str
    use: str  #: ``module:Class``
    cls: type[Stage]
    contract: Contract
    options: Mapping[str, Any]  #: checked arguments of the class, with its calibration
    model: str | None
    ladder: tuple[str, ...]  #: devices, first preferred; empty without a model
    position: Mark  #: where its name stands

    def make(self) -> Stage:
        """A fresh instance."""
        return self.cls(**self.options)


@dataclass(frozen=True, slots=True)
class GraphDevice:
    """A device of the file."""

    name: str
    use: str  #: ``module:Class``
    cls: type[Accelerator]
    options: Mapping[str, Any]  #: checked arguments of the class
    block: Node  #: as written, to be made again in another process
    isolation: Restarts | None = None  #: in a process of its own, started anew by these rules

    def make(self) -> Accelerator:
        """A fresh instance in this process, which has opened nothing."""
        return self.cls(**self.options)


@dataclass(frozen=True, slots=True)
class Graph:
    """A graph file without mistakes."""

    name: str
    file: Path
    stages: tuple[GraphStage, ...]  #: in the order of the file, as in `topology`
    devices: Mapping[str, GraphDevice]
    models: Mapping[str, ModelSpec]  #: those that the stages use
    topology: Topology  #: the same stages as the scheduler sees them
    parameters: Mapping[str, Any]
    expect: ExpectSpec  #: what a run must keep to, outputs as ``stage/port``
    warnings: tuple[Mistake, ...]
    placement: Placement = NOWHERE  #: the process of each stage; a plan needs none
    processes: Mapping[str, GraphProcess] = field(default_factory=dict)
    hosts: Mapping[str, GraphHost] = field(default_factory=dict)
    faults: GraphFaults = field(default_factory=GraphFaults)  #: what goes wrong, and when
    written: Written | None = None  #: the resolved file; None where the graph came from no file

    def part(self, process: str) -> tuple[Graph, Part]:
        """What one process runs, as a graph of its own: its stages, and where it meets others."""
        part = part_of(self.topology, self.placement, process)
        here = {name for name, its in self.placement.process_of.items() if its == process}
        stages = tuple(stage for stage in self.stages if stage.name in here)
        return replace(self, stages=stages, topology=part.topology), part

    def stage(self, name: str) -> GraphStage:
        """The named stage; raises LookupError."""
        for stage in self.stages:
            if stage.name == name:
                return stage
        raise LookupError(name)


def load_graph(
    path: Path,
    *,
    catalog: Catalog,
    overlays: Sequence[Path] = (),
    settings: Sequence[str] = (),
    out: Path = Path("out"),
) -> Graph:
    """Read a graph file, lay `overlays` and then `settings` (``a.b.c=value``) over it, and check
    all that can be known before the run.

    `out` is what ``$out`` stands for. Every class is imported and made once; nothing is opened.
    Raises GraphError with all mistakes, in the order of the files.
    """
    report = Report()
    tree = load_tree(path, overlays, settings, report)
    tree, used = resolve_parameters(tree, out, report)
    report.tree = tree
    spec, damaged = check_shape(tree, report)

    maker = PartMaker(tree, report)
    devices = {name: maker.device(name, device.use) for name, device in spec.devices.items()}
    for name, device in spec.devices.items():
        _check_restarts(name, device, devices[name], report)
    parts = {name: maker.stage(name, stage.use) for name, stage in spec.stages.items()}

    # What could not be read is still known by name, so that what refers to it is no mistake too.
    all_devices = {**dict.fromkeys(report.entries(("devices",))), **devices}
    contracts: dict[str, Contract | None] = dict.fromkeys(report.entries(("stages",)))
    contracts |= {name: part.contract for name, part in parts.items() if part is not None}

    wirer = Wirer(contracts, damaged, report)
    nodes: list[StageNode] = []
    for name, stage in spec.stages.items():
        if (part := parts[name]) is not None:
            contract = part.contract
            check_binding(name, stage, contract, all_devices, catalog, damaged, report)
            _check_role(name, stage, contract, report)
            nodes.append(_node(name, stage, part, wirer.inputs(name, stage, contract)))
    check_structure(nodes, report)
    placement, processes, hosts = check_processes(spec, nodes, report)
    expect = check_expect(spec.expect, contracts, report)
    faults = check_faults(spec.faults, contracts, nodes, placement, report)
    report.raise_mistakes()

    made = [(node, part) for node in nodes if (part := parts[node.name]) is not None]
    assert all(part.instance is not None for _, part in made), "a stage without its mistake"
    sources = {node.name: part.instance for node, part in made if isinstance(part.instance, Source)}
    check_timing(nodes, sources, report)
    _warn_unused_parameters(tree, used, report)
    return Graph(
        name=spec.graph,
        file=path,
        stages=tuple(_stage(node, part, spec.stages[node.name], tree) for node, part in made),
        devices=MappingProxyType(
            {
                name: _device(name, device, spec.devices[name], tree)
                for name, device in devices.items()
                if device is not None
            }
        ),
        models=MappingProxyType(
            {
                stage.model: catalog.spec(stage.model)
                for stage in spec.stages.values()
                if stage.model
            }
        ),
        # One more than cores: a long step on each of them must not keep a device waiting for half a
        # millisecond of prepare (with the fusion of an image at 21 ms: 11.0 Hz of 14.3 without it).
        topology=Topology(tuple(nodes), workers=len(os.sched_getaffinity(0)) + 1),
        parameters=MappingProxyType(
            {name: node.plain() for name, node in report.entries(("parameters",)).items()}
        ),
        expect=expect,
        warnings=report.warnings,
        placement=placement,
        processes=MappingProxyType(dict(processes)),
        hosts=MappingProxyType(dict(hosts)),
        faults=faults,
        written=Written(tree, report.paths, out),
    )


def _check_role(name: str, spec: StageSpec, contract: Contract, report: Report) -> None:
    """Keys that only a source has, and keys that a source cannot have."""
    if not contract.is_source:
        if spec.min_period_ms is not None:
            what = "'min_period_ms' is the promise of a source; for an input there is 'rate_hz'"
            report.mistake(("stages", name, "min_period_ms"), what, at_key=True)
        return
    for key in ("priority", "max_in_flight", "run"):
        if getattr(spec, key) is not None:
            what = f"'{key}' has no effect on a source, which has no runs; remove it"
            report.mistake(("stages", name, key), what, at_key=True)


def _node(name: str, spec: StageSpec, part: StagePart, inputs: tuple[Input, ...]) -> StageNode:
    contract = part.contract
    return StageNode(
        name=name,
        inputs=inputs,
        outputs=tuple(port.name for port in contract.outputs),
        devices=spec.executor or (),
        # One run prepares while the device works for the other.
        max_in_flight=spec.max_in_flight or (2 if contract.is_model else 1),
        priority=spec.priority or 0,
        inline=part.cls.inline,
        stateless=part.cls.stateless,
        on_error=spec.on_error or OnError.STOP,
        min_period=_ns(spec.min_period_ms),
        wanted=spec.run == "wanted",
        timeout=_ns(spec.timeout_ms),
        degraded_period=_ns(spec.degraded_rate_hz and 1e3 / spec.degraded_rate_hz),
    )


def _device(name: str, part: ClassPart[Accelerator], spec: DeviceSpec, tree: Node) -> GraphDevice:
    block = tree.get("devices", name)
    assert block is not None
    restarts = Restarts(
        spec.restart_policy or "on-failure",
        5 if spec.max_restarts is None else spec.max_restarts,
        60.0 if spec.restart_window_s is None else spec.restart_window_s,
    )
    isolation = restarts if _isolated(spec, part) else None
    return GraphDevice(name, part.use, part.cls, part.options, block, isolation)


def _isolated(spec: DeviceSpec, part: ClassPart[Accelerator]) -> bool:
    return getattr(part.cls, "isolate", False) if spec.isolate is None else spec.isolate


def _check_restarts(
    name: str, spec: DeviceSpec, part: ClassPart[Accelerator] | None, report: Report
) -> None:
    if part is None or _isolated(spec, part):
        return
    for key in ("restart_policy", "max_restarts", "restart_window_s"):
        if getattr(spec, key) is not None:
            what = f"'{key}' is for a device in a process of its own; say isolate: true"
            report.mistake(("devices", name, key), what, at_key=True)


def _ns(ms: float | None) -> int | None:
    return None if ms is None else round(ms * 1e6)


def _stage(node: StageNode, part: StagePart, spec: StageSpec, tree: Node) -> GraphStage:
    written = tree.get("stages", node.name)
    assert written is not None
    return GraphStage(
        name=node.name,
        use=part.use,
        cls=part.cls,
        contract=part.contract,
        options=MappingProxyType(dict(part.options)),
        model=spec.model,
        ladder=node.devices,
        position=written.key or written.mark,
    )


def _warn_unused_parameters(tree: Node, used: frozenset[str], report: Report) -> None:
    for name, node in report.entries(("parameters",)).items():
        # An included file may offer parameters that this graph does not need.
        if name not in used and node.mark.origin.order == tree.mark.origin.order:
            report.warn(("parameters", name), f"nothing uses ${name}")
