"""Holds a run's report, measured or planned, against what its graph file expects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pipeline.graph.spec import ExpectSpec, OutputExpectation
from pipeline.scheduling.events import Reason

#: Left out on purpose, or by the end of the run: not lost.
NO_LOSS = {Reason.PASSED_OVER, Reason.DECIMATED, Reason.NOT_WANTED, Reason.END}

#: So long an output may be silent at the start and the end of a run together: until the first
#: result is through, and after the last. Beyond it a silence is the output's own.
START_AND_END_S = 1.0

#: What the keys of the file mean, and their units.
QUANTITIES = {
    "min_rate_hz": ("rate", "Hz"),
    "max_age_ms": ("age at p99", "ms"),
    "max_gap_ms": ("longest gap", "ms"),
    "max_drop_percent": ("lost", "%"),
    "max_cpu_cores": ("CPU", "cores"),
}


@dataclass(frozen=True, slots=True)
class Verdict:
    """One expectation and what became of it."""

    of: str  #: an output, an edge, or "the process"
    key: str  #: as in the file: min_rate_hz, max_age_ms ...
    limit: float
    found: float | None  #: None: not measured, offline or since nothing came
    met: bool | None  #: None: offline says nothing of it

    def __str__(self) -> str:
        name, unit = QUANTITIES[self.key]
        bound = "at least" if self.key.startswith("min") else "at most"
        found = "not known, nothing came" if self.found is None else f"{self.found:.4g} {unit}"
        return f"{self.of}: {name} {found}, expected {bound} {self.limit:g} {unit}"


def verdicts(expect: ExpectSpec, report: Mapping[str, Any]) -> list[Verdict]:
    """Every expectation of a file, in its order, judged by a report.

    Rates, ages, gaps and CPU of an offline run say nothing, so they are not judged.
    """
    offline = bool(report["offline"])
    found = [
        verdict
        for name, rule in expect.outputs.items()
        for verdict in _output(name, rule, report["outputs"][name], report["wall_s"])
    ]
    if expect.max_cpu_cores is not None:
        cores = report["cpu"]["process_cores"]
        found.append(_at_most("the process", "max_cpu_cores", expect.max_cpu_cores, cores))
    if offline:
        found = [Verdict(each.of, each.key, each.limit, None, None) for each in found]
    for name, rule in expect.inputs.items():
        if rule.max_drop_percent is not None:
            for edge, book in report["edges"].items():
                if edge.partition("->")[2] == name:
                    percent = lost_percent(book)
                    found.append(_at_most(edge, "max_drop_percent", rule.max_drop_percent, percent))
    return found


def failed(judged: list[Verdict]) -> tuple[str, ...]:
    """A sentence for each that was not met."""
    return tuple(str(verdict) for verdict in judged if verdict.met is False)


def lost_percent(book: Mapping[str, Any]) -> float | None:
    """Of an edge's messages, how many were lost; None where none came."""
    if not book["produced"]:
        return None
    dropped: Mapping[str, int] = book["dropped"]
    lost = sum(count for reason, count in dropped.items() if reason not in NO_LOSS)
    return 100.0 * lost / int(book["produced"])


def _output(
    name: str, rule: OutputExpectation, output: Mapping[str, Any], wall_s: float
) -> Iterator[Verdict]:
    rate_hz, count = output["rate_hz"], output["count"]
    heard_s = (count - 1) / rate_hz if rate_hz else 0.0
    silent_s = max(0.0, wall_s - heard_s - START_AND_END_S)
    if rule.min_rate_hz is not None:
        rate = (count - 1) / (heard_s + silent_s) if rate_hz else 0.0
        met = rate >= rule.min_rate_hz
        yield Verdict(name, "min_rate_hz", rule.min_rate_hz, rate, met)
    if rule.max_age_ms is not None:
        age = (output["age_from_stamp_ms"] or {}).get("p99")
        yield _at_most(name, "max_age_ms", rule.max_age_ms, age)
    if rule.max_gap_ms is not None:
        gap = max(output["longest_gap_ms"] or 0.0, silent_s * 1e3) if rate_hz else wall_s * 1e3
        yield _at_most(name, "max_gap_ms", rule.max_gap_ms, gap)


def _at_most(of: str, key: str, limit: float, found: float | None) -> Verdict:
    return Verdict(of, key, limit, found, found is not None and found <= limit)
