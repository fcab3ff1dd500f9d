"""The cost table that `overflight plan` reads, made of the runs of a profile."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from pipeline.graph.graph import Graph
from pipeline.stage import Source
from tools.bench.machine import cpu_model

HEAD = """\
# What each step of {graph} cost, measured by overflight profile --save-costs, for overflight plan.
# Wall times of a step in ms; cpu_ms is the mean CPU time of the same step, an infer's with what its
# device took beside the calling thread and with the transfer to it.
"""


class CostTable:
    """Collects the costs of every run; a later run of a stage on a device replaces an earlier."""

    def __init__(self) -> None:
        self._costs: dict[tuple[str, str], dict[str, Any]] = {}
        self._sources: dict[str, dict[str, float]] = {}
        self._events = 0  #: messages and steps
        self._between_s = 0.0  #: CPU of the framework for them

    def add(self, graph: Graph, report: Mapping[str, Any]) -> None:
        """Enter every stage and source of a run."""
        for name, stage in report["stages"].items():
            for device, steps in stage["steps"].items():
                self._costs[name, device] = _entry(name, device, steps)
        for planned in graph.stages:
            if issubclass(planned.cls, Source):
                made = planned.make()
                assert isinstance(made, Source)
                ports = graph.topology.stage(planned.name).outputs
                measured = report["outputs"][f"{planned.name}/{ports[0]}"]
                if (entry := _source(made, measured)) is not None:
                    self._sources[planned.name] = entry
        self._events += sum(
            cost["count"]
            for stage in report["stages"].values()
            for steps in stage["steps"].values()
            for cost in steps.values()
        )
        parts = report["cpu"]["parts_cores"]
        self._between_s += (parts["scheduler"] + parts["drivers"]) * report["wall_s"]

    def write(self, path: Path, graph: Graph) -> None:
        """Write the file. Raises OSError."""
        table = {
            "machine": {
                "cores": len(os.sched_getaffinity(0)),
                "event_us": round(self._between_s / max(self._events, 1) * 1e6, 1),
                "cpu": cpu_model(),
            },
            "sources": self._sources,
            "costs": [self._costs[key] for key in sorted(self._costs)],
        }
        text = yaml.safe_dump(table, sort_keys=False, default_flow_style=None, width=100)
        path.write_text(HEAD.format(graph=graph.name) + text)


def _entry(stage: str, device: str, steps: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    entry: dict[str, Any] = {"stage": stage, "device": device}
    entry |= {f"{step}_ms": cost["wall_ms"] for step, cost in steps.items()}
    entry["cpu_ms"] = {step: cost["cpu_ms"]["mean"] for step, cost in steps.items()}
    return entry


def _source(source: Source, output: Mapping[str, Any]) -> dict[str, float] | None:
    """When it speaks, as measured; the jitter and the phase only where the source knows them."""
    timing = source.timing()
    rate = output["rate_hz"]
    if rate is None:
        return None
    age = output["age_from_stamp_ms"] or {"p50": 0.0}
    # What the source knows of its stamps is better than what arrivals say.
    period = 1e3 / (timing.rate_hz if timing else rate)
    return {
        "period_ms": round(period, 4),
        "jitter_ms": timing.jitter_ms if timing else 0.0,
        "delay_ms": round(max(age["p50"] or 0.0, 0.0), 3),
    }
