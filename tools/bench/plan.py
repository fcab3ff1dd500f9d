"""`overflight plan` against the run that follows it, and how fast virtual time passes.

A profile of the emulated graph gives the cost table, as `overflight profile --save-costs` does; the
plan is made of that table alone; then the same graph runs live. Where others use the machine, the
two runs differ by what those do: so the plan also stands beside the profiled run, from which it
differs by the model's faults alone.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from time import perf_counter
from typing import Any

from accelerators.registry import Registry
from pipeline.drivers.plan import run_plan
from pipeline.drivers.run import run_graph
from pipeline.graph.graph import Graph, load_graph
from pipeline.measuring.costs import Costs, read_costs
from pipeline.measuring.statistics import Statistics
from pipeline.scheduling.scheduler import Scheduler
from tools.bench.harness import Effort, Row
from tools.bench.scheduler import FILE, arrivals, drive, durations
from tools.planning.plan_costs import gather
from tools.profiling.profile_costs import CostTable

GOAL_S = 10.0
VIRTUAL_S = 1000
ENDS = ("fuse_image/out", "fuse_cloud/out", "semantic_map/out")
WARM_UP_S = 3.0
FLOOR_S = 20  #: virtual


def measure(effort: Effort) -> list[Row]:
    """Speed, and the differences between the predicted and the measured figures."""
    seconds = effort.seconds or effort.of(40, 5)
    catalog = Registry.open()
    graph = load_graph(FILE, catalog=catalog)
    _run(graph, catalog, min(WARM_UP_S, seconds))
    profiled = _run(graph, catalog, seconds)
    followed = _run(graph, catalog, seconds)
    costs = _costs(graph, catalog, profiled)
    report = run_plan(graph, costs, seconds=seconds).report
    return [
        _speed(graph, costs, effort.of(VIRTUAL_S, 20)),
        *differences(report, followed, "the run after the profile"),
        *differences(report, profiled, "the profiled run itself", hold=False),
    ]


def _costs(graph: Graph, catalog: Registry, report: Mapping[str, Any]) -> Costs:
    """The cost table of a run, through its file."""
    table = CostTable()
    table.add(graph, report)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "costs.yaml"
        table.write(file, graph)
        read = read_costs(file)
    return gather(graph, catalog, read, read.machine.cores).costs


def _run(graph: Graph, catalog: Registry, seconds: float) -> dict[str, Any]:
    result = run_graph(graph, catalog, duration_s=seconds)
    if result.failures:
        raise RuntimeError("; ".join(result.failures))
    return result.report


def _speed(graph: Graph, costs: Costs, virtual_s: int) -> Row:
    """Beside it, the same scheduler with constant times and messages made beforehand."""
    messages, steps = arrivals(graph, FLOOR_S), durations(graph)
    scheduler = Scheduler(graph.topology, observer=Statistics(offline=False))
    started = perf_counter()
    floor = drive(scheduler, graph.topology, messages, steps) / (perf_counter() - started)
    started = perf_counter()
    events = run_plan(graph, costs, seconds=virtual_s).events
    took_s = perf_counter() - started
    return Row(
        f"{virtual_s:,} virtual s of the emulated graph",
        f"< {GOAL_S:g} s for {VIRTUAL_S:,}",
        f"{took_s:.2f} s, {events / took_s:,.0f} events/s",
        f"the bare scheduler: {floor:,.0f} events/s",
        f"{events / took_s / floor:.2f}",
        took_s * VIRTUAL_S / virtual_s < GOAL_S,
        {"virtual_s": virtual_s, "took_s": took_s, "events": events, "floor_hz": floor},
    )


def differences(
    planned: Mapping[str, Any], measured: Mapping[str, Any], which: str, *, hold: bool = True
) -> list[Row]:
    """One row for each figure that a plan promises, with the largest difference."""
    outputs, found = planned["outputs"], measured["outputs"]

    def age(report: Mapping[str, Any], port: str) -> float:
        return float(report[port]["age_from_stamp_ms"]["p50"])

    rates = {port: (outputs[port]["rate_hz"], found[port]["rate_hz"]) for port in ENDS}
    ages = {port: (age(outputs, port), age(found, port)) for port in ENDS}
    cores = {"process": (planned["cpu"]["process_cores"], measured["cpu"]["process_cores"])}
    return [
        _difference(f"rate at the outputs, {which}", "Hz", rates, 0.05, hold),
        _difference(f"p50 age at the outputs, {which}", "ms", ages, 0.10, hold),
        _difference(f"CPU of the process, {which}", "cores", cores, 0.10, hold),
    ]


def _difference(
    figure: str, unit: str, pairs: Mapping[str, tuple[float, float]], most: float, hold: bool
) -> Row:
    worst = max(abs(plan / real - 1) for plan, real in pairs.values())
    each = "; ".join(
        f"{name.removesuffix('/out')} {plan:.4g} / {real:.4g}"
        for name, (plan, real) in pairs.items()
    )
    return Row(
        f"plan against measured: {figure}",
        f"within {100 * most:g} %" if hold else "",
        f"planned / measured: {each} {unit}",
        "",
        f"{100 * worst:.1f} % off at most",
        worst <= most if hold else None,
        {name: {"planned": plan, "measured": real} for name, (plan, real) in pairs.items()},
    )
