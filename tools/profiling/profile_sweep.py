"""Sweeps of `overflight profile`: every model on every device, at several rates, or whole variants.

`executor` and `rate_hz` measure one stage at a time, alone with what feeds it, as in Fig 9 and
Table 1 of the paper; `overlay` measures the whole graph under each file, as in its Table 2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from pipeline.drivers.run import RunResult, run_graph
from pipeline.errors import OverflightError
from pipeline.graph.catalog import Catalog
from pipeline.graph.graph import Graph
from tools.profiling.profile_page import profile_page
from tools.profiling.profile_variants import alone, at_rate, on_device, why_not


@dataclass(frozen=True, slots=True)
class Sweep:
    """What `--sweep` asked for."""

    executor: bool = False
    rates_hz: tuple[float, ...] = ()
    overlays: tuple[Path, ...] = ()

    @classmethod
    def parse(cls, words: Sequence[str]) -> Sweep:
        """Of ``executor``, ``rate_hz=1,2,5`` and ``overlay=a.yaml,b.yaml``. Raises BadParameter."""
        executor, rates, overlays = False, [], []
        for word in words:
            name, equals, text = word.partition("=")
            values = [value.strip() for value in text.split(",") if value.strip()]
            if name == "executor" and not equals:
                executor = True
            elif name == "rate_hz" and values:
                rates += [_rate(value) for value in values]
            elif name == "overlay" and values:
                overlays += [Path(value) for value in values]
            else:
                raise typer.BadParameter(
                    f"'{word}' is no sweep; write executor, rate_hz=1,2,5 or overlay=a.yaml,b.yaml"
                )
        if overlays and (executor or rates):
            raise typer.BadParameter("overlay sweeps the whole graph; give it a command of its own")
        return cls(executor, tuple(rates), tuple(overlays))


@dataclass(frozen=True, slots=True)
class Point:
    """One run of a sweep."""

    variant: str  #: a stage, or the name of an overlay
    stage: str | None  #: None: the whole graph
    device: str
    wanted_hz: float | None
    graph: Graph
    why_not: str | None = None  #: why it cannot run

    def __str__(self) -> str:
        rate = "" if self.wanted_hz is None else f" at {self.wanted_hz:g} Hz"
        return f"{self.variant}{f' on {self.device}' if self.device else ''}{rate}"


def points(
    graph: Graph, catalog: Catalog, sweep: Sweep, overlay: Callable[[Path], Graph]
) -> list[Point]:
    """Every run of the sweep, in order; `overlay` loads the graph with one file more."""
    if sweep.overlays:
        return [Point(path.stem, None, "", None, overlay(path)) for path in sweep.overlays]
    found = []
    for stage in graph.stages:
        if stage.model is None:
            continue
        for device in graph.devices if sweep.executor else stage.ladder[:1]:
            reason = why_not(catalog, graph, stage, device)
            part = on_device(alone(graph, stage.name), stage.name, device)
            if reason:
                found.append(Point(stage.name, stage.name, device, None, part, reason))
                continue
            for rate in sweep.rates_hz or (None,):
                slowed = part if rate is None else at_rate(part, stage.name, rate)
                found.append(Point(stage.name, stage.name, device, rate, slowed))
    if not found:
        raise typer.BadParameter(f"{graph.file} has no stage with a model to sweep")
    return found


def run_points(
    every: Sequence[Point],
    catalog: Catalog,
    seconds: float,
    say: Callable[[str], None],
    done: Callable[[Point, RunResult], None],
) -> Iterator[dict[str, Any]]:
    """Run each point and give its figures; a device that does not open costs its points only."""
    failed: set[tuple[str, str]] = set()
    for number, point in enumerate(every, 1):
        if (point.variant, point.device) in failed:
            continue  # another rate would change nothing
        place = f"[{number}/{len(every)}] {point}"
        figures = _empty(point)
        if point.why_not is None:
            say(f"{place} ...")
            try:
                result = run_graph(point.graph, catalog, duration_s=seconds)
            except OverflightError as error:
                figures["failed"] = str(error)
            else:
                if result.failures:
                    figures["failed"] = "; ".join(result.failures)
                elif result.ended.startswith("signal"):
                    say("stopped; what was measured so far follows")
                    return
                else:
                    done(point, result)
                    figures |= _figures(point, result.report)
        if figures["failed"]:
            failed.add((point.variant, point.device))
            say(f"{place}: not run, {figures['failed']}")
        else:
            load = f"{figures['cpu_percent']:.1f} % of a core"
            say(f"{place}: {figures['rate_hz'] or 0:.1f} Hz, {load}")
        yield figures


def _figures(point: Point, report: Mapping[str, Any]) -> dict[str, Any]:
    page = profile_page(point.graph, report)
    rows = {row["stage"]: row for row in page["stages"]}
    if point.stage is not None:
        row = rows[point.stage]
        infer = row["steps"].get(point.device, {}).get("infer", {})
        return {
            "emulated": row["emulated"],
            "rate_hz": row["rate_hz"],
            "cpu_percent": row["cpu_percent"],
            "cpu_ms": round(sum(row["cpu_ms"].values()), 3),
            "infer_ms": infer.get("wall_ms"),
            "age_ms": row["age_ms"],
            "wall_s": report["wall_s"],
            "profile": page,
        }
    # Sensors are emulated or read from files here: what a vehicle would not pay is left out.
    inner = [row for row in page["stages"] if not row["source"]]
    rates = [row["rate_hz"] for row in inner if row["model"] and row["rate_hz"]]
    last = [row for row in inner if row["age_ms"]]
    sources = sum(row["cpu_percent"] for row in page["stages"] if row["source"])
    return {
        "emulated": any(row["emulated"] for row in inner),
        "rate_hz": min((row["rate_hz"] or 0.0 for row in last), default=min(rates, default=None)),
        "cpu_percent": round(page["process_percent"] - sources, 3),
        "cpu_ms": None,
        "infer_ms": None,
        "age_ms": max((row["age_ms"] for row in last), key=lambda age: age["p50"], default=None),
        "wall_s": report["wall_s"],
        "profile": page,
    }


def _empty(point: Point) -> dict[str, Any]:
    stage = point.graph.stage(point.stage) if point.stage else None
    return {
        "variant": point.variant,
        "stage": point.stage,
        "model": stage.model if stage else None,
        "device": point.device,
        "wanted_hz": point.wanted_hz,
        "emulated": False,
        "failed": point.why_not or "",
    }


def _rate(text: str) -> float:
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not 0 < rate < float("inf"):
        raise typer.BadParameter(f"rate_hz={text}: a rate is a number above 0")
    return rate
