"""Warns where the declared times of the sources say that a rule of an input cannot be met."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from pipeline.errors import OverflightError
from pipeline.graph.nodes import Steps
from pipeline.graph.report import Report
from pipeline.graph.structure import in_order
from pipeline.scheduling.topology import Input, Policy, Port, StageNode, Sync
from pipeline.stage import Source, Timing

_WAITING = (Sync.EXACT, Sync.NEAREST, Sync.SPAN)


@dataclass(frozen=True, slots=True)
class _Flow:
    """What is known of a stream before it flows; times in ns."""

    origin: str  #: the source that its stamps come from
    period: float
    jitter: float  #: half-width around the even raster
    lag: float  #: how long after its stamp a message usually arrives, at least


def check_timing(nodes: Sequence[StageNode], sources: Mapping[str, Source], report: Report) -> None:
    """Follow the rates of the sources along the triggers and warn; what is not known warns of
    nothing.

    The time that stages take is not known here, so every lag is a lower bound.
    """
    flows: dict[str, _Flow] = {}
    for node in in_order(nodes):
        if node.name in sources:
            if timing := _declared(sources[node.name]):
                ms = 1e6
                flows[node.name] = _Flow(
                    node.name, 1e9 / timing.rate_hz, timing.jitter_ms * ms, timing.delay_ms * ms
                )
            continue
        trigger = _thinned(flows.get(node.trigger.sources[0].stage), node.trigger)
        if trigger is None:
            continue
        _warn_queue(node, trigger, report)
        lag = trigger.lag
        for entry in node.inputs:
            for edge in entry.sources:
                flow = _thinned(flows.get(edge.stage), entry)
                if flow is None or entry.sync not in _WAITING:
                    continue
                place: Steps = ("stages", node.name, "inputs", entry.name)
                wait = _max_wait(entry, trigger)
                _warn_tolerance(entry, edge, flow, trigger, place, report)
                _warn_wait(wait, edge, flow, trigger, (*place, "max_wait_ms"), report)
                lag = max(lag, min(flow.lag, trigger.lag + wait))
        flows[node.name] = replace(trigger, lag=lag)


def _declared(source: Source) -> Timing | None:
    try:
        timing = source.timing()
    except (OverflightError, OSError, ValueError, LookupError):
        return None  # it would have to read data that is not here
    return timing if timing is not None and timing.rate_hz > 0 else None


def _thinned(flow: _Flow | None, entry: Input) -> _Flow | None:
    """The stream behind the edge's rate limit, which keeps every k-th message."""
    if flow is None or entry.period is None:
        return flow
    every = max(1, -((flow.period / 2 - entry.period) // flow.period))
    return replace(flow, period=flow.period * every)


def _max_wait(entry: Input, trigger: _Flow) -> float:
    return 2 * trigger.period if entry.max_wait is None else entry.max_wait


def _warn_queue(node: StageNode, trigger: _Flow, report: Report) -> None:
    rule = node.trigger
    if rule.policy is Policy.LATEST or rule.size < 3:
        return
    added = (rule.size - 1) * trigger.period
    rate_hz = 1e9 / trigger.period
    what = (
        f"when full, its {rule.size} messages add {_ms(added)} of age at {rate_hz:.3g} Hz; "
        f"size 2 adds one period, {_ms(trigger.period)}, and policy latest none"
    )
    report.warn(("stages", node.name, "inputs", rule.name, "queue"), what)


def _warn_tolerance(
    entry: Input, edge: Port, flow: _Flow, trigger: _Flow, steps: Steps, report: Report
) -> None:
    if entry.sync is not Sync.NEAREST or flow.origin == trigger.origin:
        return  # stamps of one source meet exactly
    furthest = flow.period / 2 + flow.jitter
    if entry.tolerance < furthest - 1:  # a nanosecond of rounding
        jitter = f" with {_ms(flow.jitter)} of jitter" if flow.jitter else ""
        what = (
            f"{_ms(entry.tolerance)} cannot always be met: {edge} comes every {_ms(flow.period)}"
            f"{jitter}, so the nearest may lie {_ms(furthest)} away"
        )
        report.warn((*steps, "tolerance_ms"), what)


def _warn_wait(
    wait: float, edge: Port, flow: _Flow, trigger: _Flow, steps: Steps, report: Report
) -> None:
    behind = flow.lag - trigger.lag
    if wait < behind:
        what = (
            f"{_ms(wait)} is over before {edge} usually arrives, {_ms(behind)} after the trigger; "
            "sets will go without it"
        )
        report.warn(steps, what)


def _ms(ns: float) -> str:
    return f"{ns / 1e6:.4g} ms"
