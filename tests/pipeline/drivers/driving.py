"""Small stages and a way to run them, for the tests of the drivers."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from typing import Any

from pipeline.clock import ManualClock, ScaledClock
from pipeline.drivers.executor import Worker
from pipeline.drivers.live import LiveDriver
from pipeline.drivers.offline import OfflineDriver
from pipeline.measuring.ending import Ended
from pipeline.measuring.observers import observed_by
from pipeline.measuring.statistics import Statistics
from pipeline.measuring.trace import Trace, TracedWorker
from pipeline.message import Message
from pipeline.model import BoundModel
from pipeline.recording.recorder import Recorder
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import StageNode, Topology
from pipeline.stage import Stage

MS = 1_000_000


def beat(count: int, period_ms: float, delay_ms: float = 0.0) -> Iterator[Message[int]]:
    """`count` messages with their number as payload."""
    for number in range(count):
        stamp = int(number * period_ms * MS)
        yield Message.at(stamp, number, received=stamp + int(delay_ms * MS))


class Collect(Stage):
    """A sink that keeps (stamp, payload, thread name)."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, Any]] = []
        self.threads: set[str] = set()

    def process(self, x: Message[Any]) -> None:
        self.seen.append((x.stamp, x.payload))
        self.threads.add(threading.current_thread().name)


class Apply(Stage):
    """Applies a function to the payload."""

    def __init__(self, function: Callable[[Any], Any], *, inline: bool = False) -> None:
        self._function = function
        self.inline = inline  # type: ignore[misc]

    def process(self, x: Message[Any]) -> Any:
        return self._function(x.payload)


class Pair(Stage):
    """Two inputs into one tuple of payloads."""

    def process(self, a: Message[Any], b: Message[Any] | None) -> tuple[Any, Any]:
        return a.payload, b.payload if b else None


class Checked:
    """Devices that a function checks; nothing can free a thread that hangs in one."""

    def __init__(self, check: Callable[[str], None]) -> None:
        self.check = check

    def interrupt(self, name: str) -> None:
        pass


class Ran:
    """What a run left."""

    def __init__(
        self, scheduler: Scheduler, statistics: Statistics, seconds: float, ended: Ended
    ) -> None:
        self.ended = ended
        self.scheduler = scheduler
        self.statistics = statistics
        self.seconds = seconds
        self.ledger = scheduler.books.ledger()
        self.runs = scheduler.books.runs()


def drive(
    nodes: Sequence[StageNode],
    stages: Mapping[str, Stage],
    sources: Mapping[str, Iterator[Any]],
    *,
    live: bool,
    models: Mapping[str, Mapping[str, BoundModel]] | None = None,
    check: Callable[[str], None] = lambda device: None,
    check_every_ms: int = 1000,
    duration_s: float | None = None,
    during: Callable[[LiveDriver | OfflineDriver], None] | None = None,
    trace: Trace | None = None,
    recorder: Recorder | None = None,
) -> Ran:
    """Run stages over sources; `during` is called with the driver at every tick."""
    topology = Topology(tuple(nodes), check_every=check_every_ms * MS)
    statistics = Statistics(offline=not live)
    observers = [statistics] if trace is None else [statistics, trace]
    make = Scheduler if recorder is None else recorder.scheduler
    scheduler = make(topology, offline=not live, observer=observed_by(*observers))
    worker = Worker if trace is None else partial(TracedWorker, trace=trace)
    if trace is not None:
        sources = {name: trace.samples(name, source) for name, source in sources.items()}
    workers = {
        node.name: worker(node, stages[node.name], (models or {}).get(node.name))
        for node in nodes
        if node.inputs
    }

    def on_failure(stage: str, error: BaseException, text: str, stamp: int | None) -> None:
        statistics.failed(stage, error, text, stamp, 0)

    driver: LiveDriver | OfflineDriver
    if live:
        clock = ScaledClock(0)
        driver = LiveDriver(
            topology,
            scheduler,
            workers,
            dict(sources),
            clock,
            Checked(check),
            statistics,
            on_failure,
        )
    else:
        driver = OfflineDriver(
            topology, scheduler, workers, dict(sources), ManualClock(), statistics, on_failure
        )
    started = time.monotonic()
    with nullcontext() if recorder is None else recorder.writing(statistics.profiler):
        ended = driver.run(duration_s, (lambda: during(driver)) if during else (lambda: None))
    return Ran(scheduler, statistics, time.monotonic() - started, ended)


def arrive(number: signal.Signals) -> None:
    """Call what Python calls when the signal arrives.

    A real one would kill a test process in which a network has used the AMX unit of its CPU on this
    thread: the kernel of some virtual machines cannot save its state for a handler.
    """
    handler = signal.getsignal(number)
    assert callable(handler)
    handler(number, None)
