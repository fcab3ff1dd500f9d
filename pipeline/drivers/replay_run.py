"""Re-enacts a recorded flight from opening its devices to the report: `--as-recorded`."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pipeline.drivers.devices import Devices
from pipeline.drivers.executor import Worker
from pipeline.drivers.opening import open_stages
from pipeline.drivers.replay import ReplayDriver
from pipeline.errors import DataError
from pipeline.graph.catalog import Catalog
from pipeline.graph.graph import Graph
from pipeline.graph.run_folder import folder_of_this_run, run_folder
from pipeline.measuring.announcements import logged_as_events
from pipeline.measuring.ending import Ended, stopped_by_signals
from pipeline.measuring.profiler import Profiler
from pipeline.measuring.report import build_report
from pipeline.measuring.statistics import Event, Statistics
from pipeline.recording.codec import Codecs
from pipeline.recording.comparing import rules_differ
from pipeline.recording.flight import Flight
from pipeline.recording.left_behind import restore
from pipeline.recording.outline import Outline
from pipeline.recording.payloads import Payloads
from pipeline.recording.reenactment import Different
from pipeline.scheduling.topology import Port, StageNode


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """How a replay went."""

    report: dict[str, Any]
    failures: tuple[str, ...]  #: what is not as in the flight, one sentence each
    events: tuple[Event, ...]


def replay_flight(
    graph: Graph,
    catalog: Catalog,
    flight: Flight,
    codecs: Codecs,
    *,
    feed: Collection[str] = (),
    progress: Callable[[int, int], None] | None = None,
) -> ReplayResult:
    """Decide everything as recorded, execute every step, compare every output's hash.

    Stages in `feed`, and those whose executor is absent, get their recorded outputs instead.
    `progress` is told the events done and all of them. Raises DataError where the flight cannot be
    re-enacted: another graph, a gap, an output that was not recorded.
    """
    recorded = flight.manifest
    if recorded.process:
        graph, _ = graph.part(recorded.process)
    _check_rules(flight, graph)
    sources = [port for node in graph.topology.stages for port in _outputs(node, sources=True)]
    outline = Outline.of(flight, sources)
    _check_sources(flight, outline, sources)
    topology = recorded.topology  # with the number of workers that were there
    statistics = Statistics(offline=recorded.offline, profiler=Profiler())
    with contextlib.ExitStack() as stack:
        stack.enter_context(folder_of_this_run(graph))
        if graph.written is not None:
            restore(flight.reader, run_folder(graph.written.out))
        stack.enter_context(logged_as_events(statistics, lambda: 0))
        stack.enter_context(statistics.profiler)
        devices = stack.enter_context(Devices(graph, catalog, statistics.profiler))
        lost = devices.open(all_may_fail=True)
        fed = _fed(graph, flight, outline, feed, lost)
        left_out = {port.stage for port in sources} | fed.keys()
        stages = open_stages(graph, catalog, stack, statistics, without=left_out)
        workers = {
            node.name: Worker(node, stages[node.name], devices.models(node.name))
            for node in topology.stages
            if node.name in stages
        }
        fed_ports = [port for name in fed for port in _outputs(topology.stage(name))]
        read = [port for port in (*sources, *fed_ports) if outline.published.get(port)]
        driver = ReplayDriver(
            topology,
            outline,
            workers,
            Payloads(flight, read, codecs),
            fed,
            statistics,
            offline=recorded.offline,
            observer=statistics,
        )

        def tick() -> None:
            if progress is not None:
                progress(driver.events, outline.events)

        signaled: list[signal.Signals] = []

        def on_signal(number: signal.Signals) -> None:
            signaled.append(number)
            driver.stop()

        different: str | None = None
        started = time.monotonic_ns()
        statistics.profiler.start(graph.devices)
        with stopped_by_signals(on_signal):
            try:
                whole = driver.run(flight.pages(), tick)
            except Different as error:
                different, whole = str(error), False
        wall_ns = time.monotonic_ns() - started
        cpu = statistics.profiler.stop(statistics.scheduler_ns)
        own: dict[str, Mapping[str, float]] = {
            node.name: dict(stages[node.name].statistics()) if node.name in stages else {}
            for node in topology.stages
        }
        known = devices.describe()
    report = build_report(
        replace(graph, topology=topology),
        driver.scheduler,
        statistics,
        own,
        {name: known.get(name, {}) for name in driver.scheduler.devices()},
        wall_ns,
        cpu.total,
        offline=recorded.offline,
        cpu=cpu,
    )
    report["ended"] = f"signal {signaled[0].name}" if signaled else str(Ended.SOURCES)
    report["replay"] = {
        "flight": str(flight.path),
        "events_recorded": outline.events,
        **_compared(driver, different),
        "fed": dict(fed),
        "whole": whole,
    }
    return ReplayResult(
        report, tuple(_failures(driver, different, statistics)), tuple(statistics.events)
    )


def _outputs(node: StageNode, *, sources: bool | None = None) -> Iterator[Port]:
    if sources is None or node.is_source == sources:
        yield from (Port(node.name, name) for name in node.outputs)


def _check_rules(flight: Flight, graph: Graph) -> None:
    """Refuse a graph that would decide otherwise, naming the first difference."""
    difference = rules_differ(flight.manifest.topology, graph.topology)
    if difference is not None:
        raise DataError(
            f"{flight.path} was recorded with other rules: {difference}. Replay it with its own "
            f"graph: overflight run {flight.path} --as-recorded"
        )


def _compared(driver: ReplayDriver, different: str | None) -> dict[str, Any]:
    """What was as in the flight, and the first that was not."""
    return {
        "events": driver.events,
        "decisions_identical": different is None,
        "first_different_decision": different,
        "outputs_compared": driver.compared,
        "outputs_different": driver.differences,
        "first_different_outputs": driver.different,
        "outputs_not_compared": driver.not_compared,
    }


def _check_sources(flight: Flight, outline: Outline, sources: Collection[Port]) -> None:
    """Refuse what cannot be exact, naming the first reason."""
    way_out = "Record with `--record-edges sources` (the default)"
    for port in sources:
        if not outline.published.get(port):
            continue
        if port not in flight.channels:
            raise DataError(f"{flight.path}: the source {port} was not recorded. {way_out}")
        if not flight.is_exact(port):
            channel = flight.channels[port]
            raise DataError(
                f"{flight.path}: the source {port} was not recorded losslessly "
                f"({channel.schema}). {way_out}, or give its payload a codec that is"
            )
    if outline.gap is not None:
        raise DataError(
            f"{flight.path} cannot be re-enacted: {outline.gap}. --speed max replays its messages, "
            "with decisions of its own"
        )


def _fed(
    graph: Graph,
    flight: Flight,
    outline: Outline,
    feed: Collection[str],
    lost: Mapping[str, str],
) -> dict[str, str]:
    """The stages that get recorded outputs, and why; refuses those whose outputs are not there."""
    fed = dict.fromkeys(feed, "as asked")
    for name in feed:
        if name not in {stage.name for stage in graph.stages if not stage.contract.is_source}:
            raise DataError(f"--feed: no stage '{name}' with inputs in the graph")
    for stage, devices in outline.ran_on.items():
        for device in sorted(devices & lost.keys()):
            fed.setdefault(stage, f"{device}: {lost[device]}")
    missing = [
        str(port)
        for name in fed
        for port in _outputs(graph.topology.stage(name))
        if outline.published.get(port) and not flight.is_exact(port)
    ]
    if missing:
        reasons = "; ".join(f"{name} ({why})" for name, why in fed.items())
        raise DataError(
            f"{flight.path}: without their executors these stages need their recorded outputs: "
            f"{reasons}; and these were not recorded losslessly: {', '.join(missing)}. Record with "
            f"--record-edges sources,{','.join(missing)}"
        )
    return fed


def _failures(driver: ReplayDriver, different: str | None, statistics: Statistics) -> Iterator[str]:
    yield from statistics.failures
    if different is not None:
        yield f"the decisions are not as recorded: {different}"
    if driver.different:
        count = driver.differences
        many = "1 output is" if count == 1 else f"{count} outputs are"
        yield f"{many} not as recorded, the first: {driver.different[0]}"
