"""The profile of a run as plain values: what each step cost, and where the process's CPU went."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pipeline.measuring.cpu_time import CpuTime, StepCost
from pipeline.measuring.quantiles import milliseconds
from pipeline.scheduling.events import Step

#: What may stay unattributed: this share of all, or of a core, whichever is more (DESIGN 3.13).
SHARE_OF_ALL, SHARE_OF_A_CORE = 0.05, 0.01


def cpu_parts(cpu: CpuTime, wall_ns: int) -> dict[str, Any]:
    """Every line of the account in cores; the lines of `parts_cores` and the stages add up to
    `process_cores`."""

    def cores(ns: int) -> float:
        return round(ns / wall_ns, 5)

    allowed = max(SHARE_OF_ALL * cpu.total, SHARE_OF_A_CORE * wall_ns)
    return {
        "of_stages_cores": {name: cores(ns) for name, ns in cpu.stages.items()},
        "parts_cores": {
            **{name: cores(ns) for name, ns in cpu.shared.items()},
            "scheduler": cores(cpu.scheduler),
            "drivers": cores(cpu.drivers),
            "garbage collector": cores(cpu.collector),
            "progress display": cores(cpu.progress),
            "unattributed": cores(cpu.unattributed),
        },
        "attributed": abs(cpu.unattributed) <= allowed,
        "device_processes_cores": {name: cores(ns) for name, ns in cpu.processes.items()},
        "unknown_threads_cores": {name: cores(ns) for name, ns in cpu.strangers.items()},
    }


def mean_ms(cpu_ns: Mapping[Step, int], counts: Mapping[Step, int]) -> dict[str, float]:
    """Mean CPU time of each step of a stage on all its devices."""
    return {str(step): _mean_ms(ns, counts[step]) for step, ns in cpu_ns.items()}


def step_costs(
    costs: Mapping[tuple[str | None, Step], StepCost],
) -> dict[str, dict[str, dict[str, Any]]]:
    """By device (``cpu`` for a stage without a model), then step: wall and CPU time of one."""
    page: dict[str, dict[str, dict[str, Any]]] = {}
    for (device, step), cost in costs.items():
        page.setdefault(device or "cpu", {})[str(step)] = {
            "count": cost.count,
            "wall_ms": milliseconds(cost.wall),
            "cpu_ms": {
                "mean": _mean_ms(cost.cpu_ns + cost.transfer_ns, cost.count),
                **milliseconds(cost.cpu),
            },
            **({"transfer_ms": _mean_ms(cost.transfer_ns, cost.count)} if cost.transfer_ns else {}),
        }
    return page


def _mean_ms(ns: int, count: int) -> float:
    return round(ns / 1e6 / max(count, 1), 3)
