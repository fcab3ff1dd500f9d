"""The report of a run as plain values: what `run --report` writes and the tables are made of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import chain
from typing import TYPE_CHECKING, Any

from pipeline.measuring.cpu_report import cpu_parts, mean_ms, step_costs
from pipeline.measuring.cpu_time import CpuTime
from pipeline.measuring.quantiles import Quantiles, milliseconds
from pipeline.measuring.statistics import PortStatistics, StageStatistics, Statistics
from pipeline.scheduling.devices import Usage
from pipeline.scheduling.ledger import balanced
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Port, StageNode

if TYPE_CHECKING:
    from pipeline.graph.graph import Graph


def build_report(
    graph: Graph,
    scheduler: Scheduler,
    statistics: Statistics,
    own: Mapping[str, Mapping[str, float]],
    devices: Mapping[str, Mapping[str, Any]],
    wall_ns: int,
    cpu_ns: int,
    *,
    offline: bool,
    cpu: CpuTime | None = None,
) -> dict[str, Any]:
    """Everything that a run measured; null where offline has no meaning.

    `cpu` is where `cpu_ns` went; a plan does not know.
    """
    wall_s = wall_ns / 1e9
    ledger = scheduler.books.ledger()
    runs = scheduler.books.runs()
    return {
        "graph": graph.name,
        "wall_s": round(wall_s, 3),
        "offline": offline,
        "stages": {
            node.name: _stage(node, runs, scheduler, statistics, None if offline else wall_s)
            | ({"statistics": dict(own[node.name])} if own.get(node.name) else {})
            for node in graph.topology.stages
        },
        "edges": ledger,
        "ledger_balanced": balanced(ledger),
        "outputs": {
            str(port): _output(statistics.ports.get(port, PortStatistics()), offline)
            for node in graph.topology.stages
            for port in (Port(node.name, name) for name in node.outputs)
        },
        "devices": {
            name: {
                **_used(device.usage.values(), None if offline else wall_ns),
                "up": device.up,
                **devices[name],
                "stages": {
                    stage: _used([usage], None if offline else wall_ns)
                    for stage, usage in device.usage.items()
                },
            }
            for name, device in scheduler.devices().items()
        },
        "cpu": {
            "process_cores": round(cpu_ns / wall_ns, 4),
            "stages_cores": round(_stages_cpu(statistics) / wall_ns, 4),
            "scheduler_fraction": round(statistics.scheduler_ns / max(cpu_ns, 1), 4),
            **({} if cpu is None else cpu_parts(cpu, wall_ns)),
        },
        "refused": scheduler.books.refusals(),
        "failures": list(statistics.failures),
        "events": [event.page() for event in statistics.events],
    }


def _stage(
    node: StageNode,
    runs: dict[str, dict[str, int]],
    scheduler: Scheduler,
    statistics: Statistics,
    wall_s: float | None,
) -> dict[str, Any]:
    known = statistics.stages.get(node.name, StageStatistics())
    book = runs.get(node.name)
    ports = [statistics.ports.get(Port(node.name, port)) for port in node.outputs]
    published = max((port.count for port in ports if port), default=0)
    count = book["started"] if book else published
    page: dict[str, Any] = {
        "runs": count,
        "rate_hz": round(count / wall_s, 3) if wall_s else None,
        "errors": known.errors,
        "latency_ms": milliseconds(known.latency),
        "queued_ms": milliseconds(known.queued),
        "ran_ms": milliseconds(known.ran),
        "cpu_ms": mean_ms(known.cpu_ns, known.steps),
        "steps": step_costs(statistics.profiler.costs.get(node.name, {})),
        "stopped": scheduler.stopped(node.name),
    }
    if book:
        page["ended"] = book
        page |= scheduler.books.statistics()[node.name]
        marks = scheduler.books.marks().get(node.name)
        if marks:
            page["inputs"] = marks
    return page


def _used(usages: Iterable[Usage], wall_ns: int | None) -> dict[str, Any]:
    """What some stages took of a device: runs, the share of time that it was busy for them, and
    how long their prepared runs waited for it."""
    usages = list(usages)
    busy_ns = sum(usage.busy_ns for usage in usages)
    waits = _quantiles(chain.from_iterable(usage.waits_ns for usage in usages))
    return {
        "runs": sum(usage.runs for usage in usages),
        "busy_fraction": None if wall_ns is None else round(busy_ns / wall_ns, 4),
        "wait_ms": None if wall_ns is None else milliseconds(waits),
    }


def _output(statistics: PortStatistics, offline: bool) -> dict[str, Any]:
    rate = None if offline else statistics.rate_hz()
    return {
        "count": statistics.count,
        "rate_hz": None if rate is None else round(rate, 3),
        "longest_gap_ms": None if offline else round(statistics.longest_gap_ns / 1e6, 3),
        "age_from_stamp_ms": None if offline else milliseconds(statistics.age_from_stamp),
        "age_from_arrival_ms": None if offline else milliseconds(statistics.age_from_arrival),
        "age_by_stream_ms": {
            stream: milliseconds(ages) for stream, ages in statistics.age_by_stream.items()
        },
    }


def _stages_cpu(statistics: Statistics) -> int:
    return sum(sum(stage.cpu_ns.values()) for stage in statistics.stages.values())


def _quantiles(values: Iterable[int]) -> Quantiles:
    quantiles = Quantiles()
    for value in values:
        quantiles.add(value)
    return quantiles
