"""Runs a graph from opening its devices to the report: what `overflight run` calls."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median_low
from types import FrameType
from typing import Any

from pipeline.clock import ScaledClock
from pipeline.drivers.executor import Worker
from pipeline.drivers.live import LiveDriver
from pipeline.drivers.offline import OfflineDriver
from pipeline.drivers.report import build_report
from pipeline.drivers.statistics import Event, Statistics
from pipeline.errors import DeviceError, OverflightError
from pipeline.graph.catalog import Catalog
from pipeline.graph.graph import Graph
from pipeline.message import Message
from pipeline.model import Accelerator, BoundModel
from pipeline.scheduling.events import Reason
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Port
from pipeline.stage import ModelStage, Source, Stage

#: Reasons that a person watching a run counts as a loss.
LOSSES = tuple(set(Reason) - {Reason.PASSED_OVER, Reason.DECIMATED, Reason.NOT_WANTED})


@dataclass(frozen=True, slots=True)
class OutputSnapshot:
    """One output port while the graph runs."""

    count: int
    rate_hz: float | None
    age_ms: float | None  #: median age of the oldest sample in it


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The run as it stands."""

    elapsed_s: float
    outputs: Mapping[str, OutputSnapshot]
    dropped: int  #: messages lost, without those that no set needed and that rate_hz leaves out
    events: Sequence[Event]  #: everything that a person should know, so far; grows


@dataclass(frozen=True, slots=True)
class RunResult:
    """How a run went."""

    report: dict[str, Any]
    failures: tuple[str, ...]  #: what failed, one sentence each; empty when all is well
    events: tuple[Event, ...] = field(default=())


def run_graph(
    graph: Graph,
    catalog: Catalog,
    *,
    speed: float | None = 1.0,
    duration_s: float | None = None,
    progress: Callable[[Snapshot], None] | None = None,
) -> RunResult:
    """Run a graph to the end of its sources, for `duration_s`, or to Ctrl-C.

    `speed` is graph time over real time; None is offline: as fast as possible, nothing dropped,
    the same results every time. Raises OverflightError where a device or stage does not open.
    """
    offline = speed is None
    statistics = Statistics(offline=offline)
    scheduler = Scheduler(graph.topology, offline=offline, observer=statistics)
    started = time.monotonic_ns()
    cpu_started = time.process_time_ns()

    def on_failure(stage: str, error: BaseException, text: str, stamp: int | None) -> None:
        statistics.failed(stage, error, text, stamp, stamp or 0)

    def tick() -> None:
        if progress is not None:
            progress(_snapshot(graph, statistics, time.monotonic_ns() - started))

    with contextlib.ExitStack() as stack:
        models = _open_models(graph, catalog, scheduler, statistics, stack)
        stages = _open_stages(graph, catalog, stack, statistics)
        workers = {
            node.name: Worker(node, stages[node.name], models.get(node.name))
            for node in graph.topology.stages
        }
        sources: dict[str, Iterator[Message[Any]]] = {
            name: stage.messages() for name, stage in stages.items() if isinstance(stage, Source)
        }
        driver: LiveDriver | OfflineDriver
        if speed is None:
            driver = OfflineDriver(
                graph.topology, scheduler, workers, sources, statistics, on_failure
            )
        else:
            sources, origin = _first_arrivals(sources)
            driver = LiveDriver(
                graph.topology,
                scheduler,
                workers,
                sources,
                ScaledClock(origin, speed),
                statistics,
                on_failure,
            )
        started = time.monotonic_ns()
        cpu_started = time.process_time_ns()
        with _stopped_by_signals(driver.stop):
            driver.run(duration_s, tick)
        wall_ns = time.monotonic_ns() - started
        cpu_ns = time.process_time_ns() - cpu_started
        own = {name: dict(stage.statistics()) for name, stage in stages.items()}
    report = build_report(graph, scheduler, statistics, own, wall_ns, cpu_ns, offline=offline)
    return RunResult(report, tuple(statistics.failures), tuple(statistics.events))


def _open_models(
    graph: Graph,
    catalog: Catalog,
    scheduler: Scheduler,
    statistics: Statistics,
    stack: contextlib.ExitStack,
) -> dict[str, dict[str, BoundModel]]:
    """Open every device that a ladder names and load the models on it: by stage, then device.

    A device that does not open is announced and left out where the ladder goes on without it.
    """
    devices: dict[str, Accelerator] = {}
    down: dict[str, str] = {}
    for name in dict.fromkeys(rung for stage in graph.stages for rung in stage.ladder):
        device = graph.devices[name].make()
        stack.callback(device.close)
        probe = device.probe()
        if probe.available:
            devices[name] = device
        else:
            down[name] = probe.reason
    loaded: dict[tuple[str, str], BoundModel] = {}
    models: dict[str, dict[str, BoundModel]] = {}
    for stage in graph.stages:
        if stage.model is None:
            continue
        rungs = [rung for rung in stage.ladder if rung in devices]
        if not rungs:
            reasons = "; ".join(f"{rung}: {down[rung]}" for rung in stage.ladder)
            raise DeviceError(f"stages.{stage.name}: no device of its executor opens ({reasons})")
        for rung in rungs:
            key = (stage.model, rung)
            if key not in loaded:
                loaded[key] = catalog.load(stage.model, devices[rung])
            models.setdefault(stage.name, {})[rung] = loaded[key]
    for name, reason in down.items():
        statistics.event("device_down", name, f"does not open, left out: {reason}", 0)
        scheduler.device_down(name, 0)
    return models


def _open_stages(
    graph: Graph, catalog: Catalog, stack: contextlib.ExitStack, statistics: Statistics
) -> dict[str, Stage]:
    """Make and open every stage; each is closed when the stack unwinds, in reverse order."""
    stages: dict[str, Stage] = {}
    for planned in graph.stages:
        stage = planned.make()
        if isinstance(stage, ModelStage) and planned.model is not None:
            stage.model = catalog.spec(planned.model)
        stack.callback(_close, planned.name, stage, statistics)
        try:
            stage.open()
        except OSError as error:
            raise OverflightError(f"stages.{planned.name}: does not open: {error}") from error
        stages[planned.name] = stage
    return stages


def _close(name: str, stage: Stage, statistics: Statistics) -> None:
    """Close a stage; a failure to do so must not keep the others open."""
    try:
        stage.close()
    except Exception as error:
        statistics.failures.append(f"{name}: close failed: {type(error).__name__}: {error}")


def _first_arrivals(
    sources: Mapping[str, Iterator[Message[Any]]],
) -> tuple[dict[str, Iterator[Message[Any]]], int]:
    """The sources again, and when their first message arrives: the origin of the graph's clock."""
    ready: dict[str, Iterator[Message[Any]]] = {}
    arrivals: list[int] = []
    for name, messages in sources.items():
        first = next(messages, None)
        if first is not None:
            arrivals.append(first.received)
        ready[name] = _chain(first, messages)
    return ready, min(arrivals, default=0)


def _chain(first: Message[Any] | None, messages: Iterator[Message[Any]]) -> Iterator[Message[Any]]:
    if first is not None:
        yield first
    yield from messages


def _snapshot(graph: Graph, statistics: Statistics, elapsed_ns: int) -> Snapshot:
    outputs: dict[str, OutputSnapshot] = {}
    for node in graph.topology.stages:
        for port in node.outputs:
            key = Port(node.name, port)
            known = statistics.ports.get(key)
            age = median_low(known.recent_ages) if known and known.recent_ages else None
            outputs[str(key)] = OutputSnapshot(
                known.count if known else 0,
                known.rate_hz() if known and not statistics.offline else None,
                None if age is None else age / 1e6,
            )
    return Snapshot(
        elapsed_ns / 1e9,
        outputs,
        sum(statistics.drops[reason] for reason in LOSSES),
        statistics.events,
    )


@contextlib.contextmanager
def _stopped_by_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Ctrl-C and SIGTERM ask the run to end; a second one raises KeyboardInterrupt."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    asked = False

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        stop()

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
