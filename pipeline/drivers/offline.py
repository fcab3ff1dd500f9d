"""Runs a graph as fast as the machine allows, with results that do not depend on the machine.

The next source message, by (stamp, order in the file), is brought only when everything before it
has been worked off. Independent runs share the cores, but their results enter the scheduler in
(stamp, order): the sequence of events, and with it every set and every output, is the same on every
machine.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext

from pipeline.clock import ManualClock
from pipeline.drivers.executor import Worker
from pipeline.drivers.faulty import Sampled
from pipeline.drivers.sealing import seal
from pipeline.measuring.ending import Ended
from pipeline.measuring.profiler import Spent
from pipeline.measuring.statistics import OnFailure, Statistics
from pipeline.message import Message
from pipeline.scheduling.events import Output, Start, Step
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Port, Topology


class OfflineDriver:
    """Drives one scheduler through all messages of its sources. Use once."""

    def __init__(
        self,
        topology: Topology,
        scheduler: Scheduler,
        workers: Mapping[str, Worker],
        sources: Mapping[str, Iterator[Sampled]],
        clock: ManualClock,
        statistics: Statistics,
        on_failure: OnFailure,
    ) -> None:
        self._topology = topology
        self._scheduler = scheduler
        self._workers = workers
        self._sources = sources
        self._statistics = statistics
        self._profiler = statistics.profiler
        self._on_failure = on_failure
        self._order = {stage.name: i for i, stage in enumerate(topology.stages)}
        self._clock = clock
        self._stopped = False

    def stop(self) -> None:
        """Ask the run to end after the message at hand: callable from a signal handler."""
        self._stopped = True

    def still(self) -> AbstractContextManager[object]:
        """While it is entered nothing changes in the scheduler or the statistics: to read them."""
        return nullcontext()  # at a tick it stands still anyway

    def run(self, duration_s: float | None, tick: Callable[[], None]) -> Ended:
        """Run to the end of all sources, for `duration_s` of graph time, or to `stop`."""
        enter = self._profiler.enter_thread
        with ThreadPoolExecutor(self._topology.workers, "offline", enter) as pool:
            self._pool = pool
            ended = self._pull_all(duration_s, tick)
            self._work_off(self._scheduler.stop(self._clock.now()))
            self._profiler.read_threads()
        return ended

    def _pull_all(self, duration_s: float | None, tick: Callable[[], None]) -> Ended:
        heads: dict[str, Sampled] = {}
        for name in self._sources:
            self._advance(name, heads)
        end = None
        while heads and not self._stopped:
            name = min(heads, key=lambda source: (heads[source].stamp, self._order[source]))
            message = heads[name]
            if duration_s is not None:
                end = end if end is not None else message.stamp + int(duration_s * 1e9)
                if message.stamp >= end:
                    return Ended.DURATION
            self._clock.advance_to(max(self._clock.now(), message.received))
            if isinstance(message, Message):
                self._work_off(self._scheduler.publish(Port(name), message, self._clock.now()))
            elif message.text is not None:
                self._statistics.event("fault", name, message.text, message.received)
            self._advance(name, heads)
            with self._profiler.showing():
                tick()
        return Ended.STOPPED if heads else Ended.SOURCES

    def _advance(self, name: str, heads: dict[str, Sampled]) -> None:
        """Read the next message of a source; at its end, or when it fails, its stream ends."""
        before = self._profiler.read()
        try:
            message = next(self._sources[name], None)
        except Exception as error:
            self._on_failure(name, error, traceback.format_exc(), None)
            message = None
        self._statistics.spent(name, Step.PROCESS, None, self._profiler.since(before))
        if message is not None:
            if isinstance(message, Message):
                seal(message.payload)
            heads[name] = message
            return
        heads.pop(name, None)
        self._work_off(self._scheduler.source_ended(name, self._clock.now()))

    def _work_off(self, starts: list[Start]) -> None:
        """Execute everything that these steps start, until the scheduler is quiescent."""
        pending: dict[tuple[int, int, int], tuple[Start, Future[_Done]]] = {}
        while starts or pending:
            alone = len(starts) == 1 and not pending
            for start in starts:
                run = start.run
                key = (run.inputs.trigger.stamp, self._order[run.stage], run.number)
                # One step alone runs here: nothing would run beside it.
                future = _now(self._execute, start) if alone else self._submit(start)
                pending[key] = (start, future)
            start, future = pending.pop(min(pending))
            outputs, spent, failure = future.result()
            self._statistics.spent(start.run.stage, start.step, start.run.device, spent)
            before = time.thread_time_ns()
            if failure is not None:
                self._on_failure(start.run.stage, *failure, start.run.inputs.trigger.stamp)
                starts = self._scheduler.step_failed(start.run, self._clock.now())
            else:
                starts = self._scheduler.step_done(start.run, self._clock.now(), outputs)
            self._statistics.scheduler_ns += time.thread_time_ns() - before

    def _submit(self, start: Start) -> Future[_Done]:
        return self._pool.submit(self._execute, start)

    def _execute(self, start: Start) -> _Done:
        before = self._profiler.read(start.run.device if start.step is Step.INFER else None)
        outputs: tuple[Output, ...] = ()
        failure = None
        try:
            outputs = tuple(self._workers[start.run.stage].execute(start.run, start.step))
        except Exception as error:
            failure = (error, traceback.format_exc())
        return outputs, self._profiler.since(before), failure


_Done = tuple[tuple[Output, ...], Spent, tuple[BaseException, str] | None]


def _now(function: Callable[[Start], _Done], start: Start) -> Future[_Done]:
    future: Future[_Done] = Future()
    future.set_result(function(start))
    return future
