"""Runs a graph from opening its devices to the report: what `overflight run` calls."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import dropwhile
from statistics import median_low
from typing import TYPE_CHECKING, Any

from pipeline.clock import Clock, ManualClock, ScaledClock
from pipeline.drivers.devices import Devices
from pipeline.drivers.executor import Executor, Worker
from pipeline.drivers.faulty import Sampled, with_faults
from pipeline.drivers.live import LiveDriver, freeze
from pipeline.drivers.offline import OfflineDriver
from pipeline.errors import OverflightError
from pipeline.graph.catalog import Catalog
from pipeline.graph.graph import Graph
from pipeline.graph.run_folder import folder_of_this_run
from pipeline.measuring.announcements import logged_as_events
from pipeline.measuring.ending import Ended, stopped_by_signals
from pipeline.measuring.observers import observed_by
from pipeline.measuring.profiler import Profiler
from pipeline.measuring.report import build_report
from pipeline.measuring.statistics import Event, Statistics
from pipeline.measuring.status import LOSSES, Pages, Status
from pipeline.measuring.trace import Trace, TracedWorker
from pipeline.message import Message
from pipeline.processes.joint import Joint
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Port, Role
from pipeline.stage import ModelStage, Source, Stage

if TYPE_CHECKING:
    from pipeline.recording.recorder import Recorder


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
    ended: str = Ended.SOURCES  #: one of `Ended`, or ``signal SIGINT``


def run_graph(
    graph: Graph,
    catalog: Catalog,
    *,
    speed: float | None = 1.0,
    duration_s: float | None = None,
    progress: Callable[[Snapshot], None] | None = None,
    profiler: Profiler | None = None,
    trace: Trace | None = None,
    board: Pages | None = None,
    recorder: Recorder | None = None,
    joint: Joint | None = None,
) -> RunResult:
    """Run a graph to the end of its sources, for `duration_s`, or to Ctrl-C.

    `speed` is graph time over real time; None is offline: as fast as possible, nothing dropped,
    the same results every time. A `trace` notes what was done when; on a `board` other processes
    see how it stands; a `recorder` (entered by the caller) writes messages and decisions. `joint`
    ties a part of a graph, run live, to the other processes. Raises OverflightError where a device
    or stage does not open.
    """
    offline = speed is None
    statistics = Statistics(offline=offline, profiler=profiler)
    profiler = statistics.profiler
    observers = [statistics, *([trace] if trace is not None else [])]
    make = Scheduler if recorder is None else recorder.scheduler
    scheduler = make(graph.topology, offline=offline, observer=observed_by(*observers))
    if trace is not None:
        statistics.on_event = trace.told
    status = None
    if board is not None:
        status = Status(board, graph.name, graph.topology, scheduler, statistics)
    started = time.monotonic_ns()

    def on_failure(stage: str, error: BaseException, text: str, stamp: int | None) -> None:
        statistics.failed(stage, error, text, stamp, stamp or 0)

    def tick() -> None:
        if progress is not None:
            progress(_snapshot(graph, statistics, time.monotonic_ns() - started))
        if status is not None:
            status.tick()

    def on_signal(number: signal.Signals) -> None:
        text = f"by {number.name}: runs in flight end, what is queued is dropped"
        statistics.event("stopped", graph.name, text, clock.now())
        signaled.append(number)
        driver.stop()

    signaled: list[signal.Signals] = []
    clock: Clock = ManualClock()  # nothing runs yet: it stands at 0
    with contextlib.ExitStack() as stack:
        if joint is None:
            stack.enter_context(folder_of_this_run(graph))
        stack.enter_context(logged_as_events(statistics, lambda: clock.now()))
        stack.enter_context(profiler)
        devices = stack.enter_context(Devices(graph, catalog, profiler))
        for name, reason in devices.open().items():
            text = f"does not open: {reason}"
            statistics.event("device_error", name, text, 0)
            scheduler.device_down(name, 0)
        stages = open_stages(graph, catalog, stack, statistics)
        worker = Worker if trace is None else partial(TracedWorker, trace=trace)
        workers = {
            node.name: worker(node, stages[node.name], devices.models(node.name))
            for node in graph.topology.stages
            if node.role is Role.STAGE
        }
        executors: Mapping[str, Executor] = workers
        if joint is not None:
            with profiler.building("transport"):
                joint.open()
            joint.exchange.connect()
            executors = {**workers, **joint.exchange.senders}
        sources: dict[str, Iterator[Message[Any]]] = {
            name: stage.messages() for name, stage in stages.items() if isinstance(stage, Source)
        }
        origin: int | None = None
        if speed is not None or graph.faults.sources:
            sources, origin = _first_arrivals(sources)
        go = None
        if joint is not None:
            with profiler.building("transport"):  # its threads come with the others' connections
                go = joint.ready(origin)
        if trace is not None:
            sources = {name: trace.samples(name, source) for name, source in sources.items()}
        began = (origin or 0) if go is None else go.origin
        sampled = with_faults(sources, graph.faults.sources, began)
        if joint is None and (left := graph.faults.between_processes):
            text = "left out: all stages share one process here"
            for name in left:
                statistics.event("fault", name, text, began)
        driver: LiveDriver | OfflineDriver
        if speed is None:
            clock = ManualClock()
            driver = OfflineDriver(
                graph.topology, scheduler, workers, sampled, clock, statistics, on_failure
            )
        else:
            clock = ScaledClock(began, speed)
            if go is not None:
                clock = ScaledClock(go.origin, speed, began_ns=go.began_ns)
                sampled = _from_now_on(sampled, clock) if go.late else sampled
            driver = LiveDriver(
                graph.topology,
                scheduler,
                executors,
                sampled,
                clock,
                devices,
                statistics,
                on_failure,
                None if joint is None else joint.exchange,
            )
        if speed is not None:
            freeze()
        started = time.monotonic_ns()
        profiler.start(graph.devices)
        if recorder is not None:
            stack.enter_context(recorder.writing(profiler))
        if status is not None:
            status.begin(speed, clock, driver.still)
        with stopped_by_signals(on_signal):
            if joint is not None:
                assert isinstance(driver, LiveDriver)
                joint.exchange.begin(driver, clock, began)
                joint.running(driver)
            how = driver.run(duration_s, tick)
            if joint is not None:
                joint.exchange.end()
        wall_ns = time.monotonic_ns() - started
        cpu = profiler.stop(statistics.scheduler_ns)
        own = {name: dict(stage.statistics()) for name, stage in stages.items()}
        known = devices.describe()
    report = build_report(
        graph, scheduler, statistics, own, known, wall_ns, cpu.total, offline=offline, cpu=cpu
    )
    ended = f"signal {signaled[0].name}" if signaled else str(how)
    report["ended"] = ended
    if recorder is not None:
        report["recording"] = recorder.statistics()
    if joint is not None:
        report["links"] = joint.books()
    return RunResult(report, tuple(statistics.failures), tuple(statistics.events), ended)


def open_stages(
    graph: Graph,
    catalog: Catalog,
    stack: contextlib.ExitStack,
    statistics: Statistics,
    without: Collection[str] = (),
) -> dict[str, Stage]:
    """Make and open every stage; each is closed when the stack unwinds, in reverse order."""
    stages: dict[str, Stage] = {}
    for planned in (stage for stage in graph.stages if stage.name not in without):
        stage = planned.make()
        if isinstance(stage, ModelStage) and planned.model is not None:
            stage.model = catalog.spec(planned.model)
        stack.callback(_close, planned.name, stage, statistics)
        try:
            with statistics.profiler.building(planned.name):
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
) -> tuple[dict[str, Iterator[Message[Any]]], int | None]:
    """The sources again, and when their first message arrives, if any does: the origin of the
    graph's clock."""
    ready: dict[str, Iterator[Message[Any]]] = {}
    arrivals: list[int] = []
    for name, messages in sources.items():
        first = next(messages, None)
        if first is not None:
            arrivals.append(first.received)
        ready[name] = _chain(first, messages)
    return ready, min(arrivals, default=None)


def _from_now_on(
    sources: Mapping[str, Iterator[Sampled]], clock: ScaledClock
) -> dict[str, Iterator[Sampled]]:
    """The sources without what arrived while their process was not there."""
    now = clock.now()
    return {
        name: dropwhile(lambda message: message.received < now, messages)
        for name, messages in sources.items()
    }


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
