"""Assignments of stages to devices with what is predicted of them, in order of merit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from pipeline.drivers.plan import Plan
from pipeline.graph.graph import Graph
from pipeline.measuring.expectations import Verdict
from tools.planning.plan_costs import Known

#: Rates and ages that differ by less than this share count as equal.
EQUAL = 0.05
#: From here on something that is busy holds the others up.
FULL = 0.9


@dataclass(frozen=True, slots=True)
class Option:
    """One assignment of stages to devices and what is predicted of it."""

    devices: Mapping[str, str]  #: by stage
    is_files: bool  #: as the file has it
    plan: Plan
    verdicts: tuple[Verdict, ...]

    @property
    def failed(self) -> int:
        """How many demands it does not meet."""
        return sum(verdict.met is False for verdict in self.verdicts)

    @property
    def cores(self) -> float:
        cores: float = self.plan.report["cpu"]["process_cores"]
        return cores

    def rate_hz(self, port: str) -> float:
        return self.plan.report["outputs"][port]["rate_hz"] or 0.0

    def age_ms(self, port: str) -> float:
        """The 99th percentile; infinite where nothing came."""
        ages = self.plan.report["outputs"][port]["age_from_stamp_ms"] or {}
        return math.inf if ages.get("p99") is None else ages["p99"]


@dataclass(frozen=True, slots=True)
class Ranking:
    """All that was found, the best option first."""

    graph: Graph
    ends: tuple[str, ...]  #: the outputs that a person waits for
    known: Known
    options: tuple[Option, ...]
    count: int  #: of assignments that there are
    seconds: float  #: of virtual time, each
    cores: int

    @property
    def skipped(self) -> int:
        return self.count - len(self.options)


def ranked(options: Sequence[Option], ends: Sequence[str]) -> tuple[Option, ...]:
    """Those in which every output speaks first; then by the demands met, by the age of the output
    that suffers most, beside the youngest that any reaches, so by rate, and by CPU."""
    best = {port: max(option.rate_hz(port) for option in options) or 1.0 for port in ends}
    youngest = {port: min(option.age_ms(port) for option in options) for port in ends}

    def key(option: Option) -> tuple[float, ...]:
        rate = min((option.rate_hz(port) / best[port] for port in ends), default=1.0)
        age = max((option.age_ms(port) / max(youngest[port], 1.0) for port in ends), default=1.0)
        silent = sum(not option.rate_hz(port) for port in ends)
        return silent, option.failed, _rounded(age), -_rounded(rate), option.cores

    return tuple(sorted(options, key=key))


def _rounded(share: float) -> float:
    return share if math.isinf(share) or math.isnan(share) else round(share / EQUAL)


def assignment(devices: Mapping[str, str]) -> str:
    """``edgetpu: segment_rgb, detect_rgb; igpu: segment_scan``"""
    stages: dict[str, list[str]] = {}
    for stage, device in devices.items():
        stages.setdefault(device, []).append(stage)
    return "; ".join(f"{device}: {', '.join(names)}" for device, names in sorted(stages.items()))


def resources(ranking: Ranking, option: Option) -> Iterator[tuple[str, float]]:
    """How busy each thing is that could hold the others up, as a share of its time."""
    report, cores = option.plan.report, ranking.cores
    for name, device in report["devices"].items():
        yield f"device {name}", device["busy_fraction"]
    yield f"the {cores} cores", option.cores / cores
    for stage in ranking.graph.topology.stages:
        if not stage.stateless:
            yield f"stage {stage.name} (one run at a time)", option.plan.busy[stage.name]


def bottleneck(ranking: Ranking, option: Option) -> str:
    """A sentence about what limits the graph."""
    shares = sorted(resources(ranking, option), key=lambda one: -one[1])
    devices = option.plan.report["devices"]
    full = []
    for name, share in shares:
        if share >= FULL:
            users = devices.get(name.removeprefix("device "), {}).get("stages", {})
            busy = sorted(((used["busy_fraction"], stage) for stage, used in users.items()))[::-1]
            by = ", ".join(f"{stage} {100 * part:.0f} %" for part, stage in busy)
            full.append(f"{name} busy {100 * share:.0f} % of the time" + (f" ({by})" if by else ""))
    if full:
        return f"The bottleneck is {'; then '.join(full)}."
    name, share = shares[0]
    return (
        f"Nothing is at its limit: sensors set the pace. Most in use: {name}, {100 * share:.0f} %."
    )
