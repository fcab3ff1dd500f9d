"""Runs a graph from opening its devices to the report: what `overflight run` calls."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from pipeline.clock import Clock, ManualClock, ScaledClock
from pipeline.drivers.beginning import first_arrivals, from_now_on
from pipeline.drivers.course import Course
from pipeline.drivers.devices import Devices
from pipeline.drivers.executor import Executor, Worker
from pipeline.drivers.faulty import Sampled, with_faults
from pipeline.drivers.live import LiveDriver, freeze
from pipeline.drivers.offline import OfflineDriver
from pipeline.drivers.opening import open_stages
from pipeline.drivers.snapshot import Snapshot, snapshot
from pipeline.graph.catalog import Catalog
from pipeline.graph.graph import Graph
from pipeline.graph.run_folder import folder_of_this_run
from pipeline.measuring.announcements import logged_as_events
from pipeline.measuring.ending import Ended, stopped_by_signals
from pipeline.measuring.observers import observed_by
from pipeline.measuring.profiler import Profiler
from pipeline.measuring.report import build_report
from pipeline.measuring.statistics import Event, Statistics
from pipeline.measuring.status import Pages, Status
from pipeline.measuring.trace import Trace, TracedWorker
from pipeline.message import Message
from pipeline.processes.joint import Go, Joint
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Role
from pipeline.stage import Source

if TYPE_CHECKING:
    from pipeline.recording.recorder import Recorder


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
    run = _Run(graph, catalog, speed, progress, profiler, trace, board, recorder, joint)
    with contextlib.ExitStack() as stack:
        run.open(stack)
        run.drive(stack, duration_s)
    report = run.report()
    return RunResult(
        report, tuple(run.statistics.failures), tuple(run.statistics.events), report["ended"]
    )


class _Run:
    """One run: its books from the start, then what it opens, the driver, and the report."""

    def __init__(
        self,
        graph: Graph,
        catalog: Catalog,
        speed: float | None,
        progress: Callable[[Snapshot], None] | None,
        profiler: Profiler | None,
        trace: Trace | None,
        board: Pages | None,
        recorder: Recorder | None,
        joint: Joint | None,
    ) -> None:
        self._graph = graph
        self._catalog = catalog
        self._speed = speed
        self._progress = progress
        self._trace = trace
        self._recorder = recorder
        self._joint = joint
        self._offline = speed is None
        self.statistics = Statistics(offline=self._offline, profiler=profiler)
        self._profiler = self.statistics.profiler
        observers = [self.statistics, *([trace] if trace is not None else [])]
        make = Scheduler if recorder is None else recorder.scheduler
        self._scheduler = make(
            graph.topology, offline=self._offline, observer=observed_by(*observers)
        )
        if trace is not None:
            self.statistics.on_event = trace.told
        self._status: Status | None = None
        if board is not None:
            self._status = Status(
                board, graph.name, graph.topology, self._scheduler, self.statistics
            )
        self._clock: Clock = ManualClock()  # nothing runs yet: it stands at 0
        self._started = time.monotonic_ns()
        self._signaled: list[signal.Signals] = []

    def open(self, stack: contextlib.ExitStack) -> None:
        """Open devices, stages and links, and make the driver; all is closed with the stack."""
        if self._joint is None:
            stack.enter_context(folder_of_this_run(self._graph))
        stack.enter_context(logged_as_events(self.statistics, lambda: self._clock.now()))
        stack.enter_context(self._profiler)
        self._devices = self._open_devices(stack)
        self._stages = open_stages(self._graph, self._catalog, stack, self.statistics)
        workers = self._workers()
        senders: Mapping[str, Executor] = {}
        if self._joint is not None:
            with self._profiler.building("transport"):
                self._joint.open()
            self._joint.exchange.connect()
            senders = self._joint.exchange.senders
        sources, origin = self._sources()
        go = None
        if self._joint is not None:
            with self._profiler.building("transport"):  # its threads come with the connections
                go = self._joint.ready(origin)
        if self._trace is not None:
            sources = {name: self._trace.samples(name, each) for name, each in sources.items()}
        self._began = (origin or 0) if go is None else go.origin
        sampled = with_faults(sources, self._graph.faults.sources, self._began)
        if self._joint is None:
            self._tell_what_needs_processes()
        self._driver: LiveDriver | OfflineDriver
        if self._speed is None:
            self._driver = self._offline_driver(workers, sampled)
        else:
            self._driver = self._live_driver({**workers, **senders}, sampled, self._speed, go)

    def drive(self, stack: contextlib.ExitStack, duration_s: float | None) -> None:
        """Run to the end; the recorder writes meanwhile, and until the stack is left."""
        if self._speed is not None:
            freeze()
        if self._progress is not None:  # sources read an index for it
            began = None if self._offline else self._began
            self._course = Course(self._opened_sources(), began, duration_s, self._no_end_known)
        self._started = time.monotonic_ns()
        self._profiler.start(self._graph.devices)
        if self._recorder is not None:
            stack.enter_context(self._recorder.writing(self._profiler))
        if self._status is not None:
            self._status.begin(self._speed, self._clock, self._driver.still)
        with stopped_by_signals(self._on_signal):
            if self._joint is not None:
                assert isinstance(self._driver, LiveDriver)
                self._joint.exchange.begin(self._driver, self._clock, self._began)
                self._joint.running(self._driver)
            self._how = self._driver.run(duration_s, self._tick)
            if self._joint is not None:
                self._joint.exchange.end()
        self._wall_ns = time.monotonic_ns() - self._started
        self._cpu = self._profiler.stop(self.statistics.scheduler_ns)
        self._own = {name: dict(stage.statistics()) for name, stage in self._stages.items()}
        self._known = self._devices.describe()

    def report(self) -> dict[str, Any]:
        """What came of it, once all is closed: a recorder has written, a stage may have failed."""
        report = build_report(
            self._graph,
            self._scheduler,
            self.statistics,
            self._own,
            self._known,
            self._wall_ns,
            self._cpu.total,
            offline=self._offline,
            cpu=self._cpu,
        )
        signaled = self._signaled
        report["ended"] = f"signal {signaled[0].name}" if signaled else str(self._how)
        if self._recorder is not None:
            report["recording"] = self._recorder.statistics()
        if self._joint is not None:
            report["links"] = self._joint.books()
        return report

    def _open_devices(self, stack: contextlib.ExitStack) -> Devices:
        """The devices; one that does not open is down, and the stages are told."""
        devices = stack.enter_context(Devices(self._graph, self._catalog, self._profiler))
        for name, reason in devices.open().items():
            self.statistics.event("device_error", name, f"does not open: {reason}", 0)
            self._scheduler.device_down(name, 0)
        return devices

    def _workers(self) -> dict[str, Worker]:
        """What executes the steps of each stage."""
        worker = Worker if self._trace is None else partial(TracedWorker, trace=self._trace)
        return {
            node.name: worker(node, self._stages[node.name], self._devices.models(node.name))
            for node in self._graph.topology.stages
            if node.role is Role.STAGE
        }

    def _sources(self) -> tuple[dict[str, Iterator[Message[Any]]], int | None]:
        """The messages of each source, and when the first arrives, where that matters."""
        sources: dict[str, Iterator[Message[Any]]] = {
            name: source.messages() for name, source in self._opened_sources().items()
        }
        if self._speed is None and not self._graph.faults.sources:
            return sources, None
        return first_arrivals(sources)

    def _opened_sources(self) -> dict[str, Source]:
        return {name: one for name, one in self._stages.items() if isinstance(one, Source)}

    def _no_end_known(self, source: str, text: str) -> None:
        self.statistics.event("no_end_known", source, text, self._began)

    def _tell_what_needs_processes(self) -> None:
        for name in self._graph.faults.between_processes:
            text = "left out: all stages share one process here"
            self.statistics.event("fault", name, text, self._began)

    def _offline_driver(
        self, workers: Mapping[str, Worker], sources: Mapping[str, Iterator[Sampled]]
    ) -> OfflineDriver:
        self._clock = clock = ManualClock()
        return OfflineDriver(
            self._graph.topology,
            self._scheduler,
            workers,
            sources,
            clock,
            self.statistics,
            self._on_failure,
        )

    def _live_driver(
        self,
        executors: Mapping[str, Executor],
        sources: Mapping[str, Iterator[Sampled]],
        speed: float,
        go: Go | None,
    ) -> LiveDriver:
        if go is None:
            self._clock = clock = ScaledClock(self._began, speed)
        else:
            self._clock = clock = ScaledClock(go.origin, speed, began_ns=go.began_ns)
            sources = from_now_on(sources, clock) if go.late else sources
        return LiveDriver(
            self._graph.topology,
            self._scheduler,
            executors,
            sources,
            clock,
            self._devices,
            self.statistics,
            self._on_failure,
            None if self._joint is None else self._joint.exchange,
        )

    def _on_failure(self, stage: str, error: BaseException, text: str, stamp: int | None) -> None:
        self.statistics.failed(stage, error, text, stamp, stamp or 0)

    def _tick(self) -> None:
        if self._progress is not None:
            elapsed = time.monotonic_ns() - self._started
            done = self._course.done(self._clock.now())
            self._progress(snapshot(self._graph, self.statistics, elapsed, done))
        if self._status is not None:
            self._status.tick()

    def _on_signal(self, number: signal.Signals) -> None:
        text = f"by {number.name}: runs in flight end, what is queued is dropped"
        self.statistics.event("stopped", self._graph.name, text, self._clock.now())
        self._signaled.append(number)
        self._driver.stop()
