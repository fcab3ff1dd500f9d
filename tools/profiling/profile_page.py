"""A profile as plain values, made of the report of a run: what `profile --json` prints and the
table, the HTML page and the plots are drawn from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from pipeline.graph.graph import Graph
from pipeline.measuring.status import LOSSES

#: The parts of a run in their order.
PARTS = ("prepare", "infer", "transfer", "finish", "process")


def profile_page(graph: Graph, report: Mapping[str, Any]) -> dict[str, Any]:
    """Every stage with its rate, CPU, times, waits, losses and age; then the rest of the process.

    CPU in percent of a core; `cpu_ms` is the mean CPU time of one step, by part.
    """
    cpu = report["cpu"]
    return {
        "graph": graph.name,
        "wall_s": report["wall_s"],
        "process_percent": _percent(cpu["process_cores"]),
        "attributed": cpu["attributed"],
        "stages": [_stage(graph, report, stage.name) for stage in graph.stages],
        "rest_percent": {name: _percent(cores) for name, cores in cpu["parts_cores"].items()},
        "unknown_threads_percent": {
            name: _percent(cores) for name, cores in cpu["unknown_threads_cores"].items()
        },
        "devices": {
            name: {
                "is": device["is"],
                "emulated": emulated_device(device),
                "own_process_percent": _percent(cpu["device_processes_cores"].get(name)),
                "busy_percent": _percent(device["busy_fraction"]),
                "wait_ms": device["wait_ms"],
            }
            for name, device in report["devices"].items()
            if "is" in device
        },
        "ledger_balanced": report["ledger_balanced"],
    }


def _stage(graph: Graph, report: Mapping[str, Any], name: str) -> dict[str, Any]:
    measured = report["stages"][name]
    steps = measured["steps"]
    devices = [device for device in graph.stage(name).ladder if device in steps]
    known = report["devices"]
    dropped: Counter[str] = Counter()
    trigger = graph.topology.stage(name).trigger.name if graph.topology.stage(name).inputs else ""
    lost = 0
    for edge, book in report["edges"].items():
        target, _, entry = edge.split("->")[1].partition("/")
        if target == name:
            dropped.update(book["dropped"])
            lost += sum(book["dropped"].get(why, 0) for why in LOSSES) if entry == trigger else 0
    outputs = [page for port, page in report["outputs"].items() if port.startswith(f"{name}/")]
    output = max(outputs, key=lambda page: page["count"] or 0, default=None)
    busy = [known[device]["stages"].get(name, {}).get("busy_fraction") for device in devices]
    emulated = any(emulated_device(known[device]) for device in devices)
    return {
        "stage": name,
        "model": graph.stage(name).model,
        "devices": devices,
        "emulated": emulated or "emulated" in graph.stage(name).use.lower(),
        "source": graph.topology.stage(name).is_source,
        "runs": measured["runs"],
        "rate_hz": output["rate_hz"] if output else measured["rate_hz"],
        "cpu_percent": _percent(report["cpu"]["of_stages_cores"].get(name, 0.0)),
        "cpu_ms": _cpu_ms(steps),
        "ran_ms": measured["ran_ms"],
        "queued_ms": measured["queued_ms"],
        "busy_percent": _percent(sum(share or 0 for share in busy)) if busy else None,
        "dropped": {reason: count for reason, count in dropped.items() if count},
        "lost": lost,  #: triggers that ended unused, without those that nobody asked for
        "age_ms": output["age_from_stamp_ms"] if output else None,
        "steps": steps,
    }


def _cpu_ms(steps: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Mean CPU time of each part over all devices."""
    total: dict[str, float] = {}
    count: dict[str, int] = {}
    for device in steps.values():
        for step, cost in device.items():
            n, transfer = cost["count"], cost.get("transfer_ms", 0.0)
            for part, ms in ((step, cost["cpu_ms"]["mean"] - transfer), ("transfer", transfer)):
                if part == step or ms:
                    total[part] = total.get(part, 0.0) + ms * n
                    count[part] = count.get(part, 0) + n
    return {part: round(total[part] / count[part], 3) for part in PARTS if part in total}


def emulated_device(device: Mapping[str, Any]) -> bool:
    """Whether what a device answered to its probe says so: every emulated one does."""
    return "emulated" in str(device.get("is", "")).lower()


def _percent(cores: float | None) -> float | None:
    return None if cores is None else round(100 * cores, 3)
