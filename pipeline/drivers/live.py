"""Runs a graph in real time: threads, a clock, and the one lock that owns the scheduler.

Whoever brings an event steps the scheduler under the lock and hands the runs that start straight to
their workers: a source thread per source, a thread per device, one CPU worker more than cores. A
worker that finishes a step keeps the next one where it can, so that a busy device waits for nobody.
The main thread serves deadlines and progress.
"""

from __future__ import annotations

import gc
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from queue import SimpleQueue
from typing import Any, Protocol

from pipeline.clock import ScaledClock
from pipeline.drivers.executor import Executor, Pending
from pipeline.drivers.faulty import Sampled, Unheard
from pipeline.drivers.sealing import seal
from pipeline.errors import DeviceError
from pipeline.measuring.ending import Ended
from pipeline.measuring.profiler import Spent
from pipeline.measuring.statistics import OnFailure, Statistics
from pipeline.message import Message
from pipeline.scheduling.bounds import INFINITY
from pipeline.scheduling.events import Bound, Check, Notice, Output, Run, Start, Step, Took
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Port, Role, Topology

#: How long runs in flight may go on after a stop before they are given up.
DRAIN_S = 1.5
#: The main thread looks this often at stop requests and progress.
TICK_S = 0.2
#: A thread that wants the GIL asks for it after this long (Python's default of 5 ms would be a
#: twentieth of a scan's period).
SWITCH_INTERVAL_S = 0.0005
#: One step in this many has its scheduler time measured: reading a thread's CPU clock is a system
#: call.
SAMPLE = 8


_Action = Start | Check | Notice


def freeze() -> None:
    """What is there now lives as long as the run: the garbage collector need not look at it again.

    The first time it takes some 50 ms; call it before the CPU of a run is counted.
    """
    gc.collect()
    gc.freeze()


class Guard(Protocol):
    """What the driver asks of the devices themselves."""

    def interrupt(self, name: str) -> None:
        """Free the thread of a lost device if it can be done; must not block."""
        ...

    def check(self, name: str) -> None:
        """Make a lost device work again, on its own thread; raises while it does not."""
        ...


class Outside(Protocol):
    """The other processes of the graph."""

    def tell(self, notice: Notice) -> None:
        """Tell them; must not block."""
        ...

    def tick(self) -> None:
        """Called a few times a second."""
        ...


class _Thread:
    """A worker thread and its inbox; None in it ends the thread."""

    def __init__(self, name: str, *, is_device: bool = False) -> None:
        self.name = name
        self.is_device = is_device
        self.inbox: SimpleQueue[Start | Check | None] = SimpleQueue()
        self.thread: threading.Thread | None = None


class LiveDriver:
    """Drives one scheduler until its sources end or `stop` is called. Use once."""

    def __init__(
        self,
        topology: Topology,
        scheduler: Scheduler,
        workers: Mapping[str, Executor],
        sources: Mapping[str, Iterator[Sampled]],
        clock: ScaledClock,
        guard: Guard,
        statistics: Statistics,
        on_failure: OnFailure,
        outside: Outside | None = None,
    ) -> None:
        self._scheduler = scheduler
        self._outside = outside
        self._workers = workers
        self._sources = sources
        self._clock = clock
        self._guard = guard
        self._statistics = statistics
        self._profiler = statistics.profiler
        self._on_failure = on_failure
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)  #: an earlier deadline, or done
        self._unblocked = threading.Condition(self._lock)  #: sources: room in a blocked queue
        self._armed: int | None = None  #: the deadline that the main thread sleeps for
        self._stop = threading.Event()
        #: Streams of other processes that may still bring messages.
        self._remote = {
            Port(node.name, port)
            for node in topology.stages
            if node.role is Role.REMOTE
            for port in node.outputs
        }
        self._open_sources = set(sources)
        self._blocked_sources = 0
        self._steps = 0
        self._crash: BaseException | None = None
        self._idle = [_Thread(f"cpu-{i}") for i in range(topology.workers)]
        names = sorted({name for stage in topology.stages for name in stage.devices})
        self._devices = {name: _Thread(f"dev-{name}", is_device=True) for name in names}
        self._threads = [*self._idle, *self._devices.values()]

    def stop(self) -> None:
        """Ask the run to end: callable from any thread and from a signal handler."""
        self._stop.set()

    def still(self) -> AbstractContextManager[object]:
        """While it is entered nothing changes in the scheduler or the statistics: to read them."""
        return self._lock

    def run(self, duration_s: float | None, tick: Callable[[], None]) -> Ended:
        """Run to the end of all sources, for `duration_s`, or to `stop`; then drain and join."""
        interval = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        freeze()
        gc.disable()
        try:
            self._start_threads()
            end = None if duration_s is None else time.monotonic() + duration_s
            ended = self._serve(end, tick)
        finally:
            self._shut_down()
            sys.setswitchinterval(interval)
            gc.enable()
            gc.unfreeze()
        if self._crash is not None:
            raise self._crash
        return ended

    # ------------------------------------------------------------------ main thread

    def _start_threads(self) -> None:
        for worker in self._threads:
            worker.thread = threading.Thread(target=self._work, args=(worker,), daemon=True)
            worker.thread.start()
        self._source_threads = [
            threading.Thread(target=self._read, args=(name, messages), daemon=True)
            for name, messages in self._sources.items()
        ]
        self._clock.start()
        for thread in self._source_threads:
            thread.start()

    def _serve(self, end: float | None, tick: Callable[[], None]) -> Ended:
        """Serve deadlines and progress until the run is over."""
        next_tick = time.monotonic() + TICK_S
        next_collect = time.monotonic() + 1.0
        collected = 0
        while not self._stop.is_set():
            now = time.monotonic()
            if end is not None and now >= end:
                return Ended.DURATION
            if now >= next_tick:
                next_tick = now + TICK_S
                with self._profiler.showing():
                    tick()
                if self._outside is not None:
                    self._outside.tick()
            if now >= next_collect:
                # Reference counting frees nearly everything. The rest is collected here, on the
                # thread that nobody waits for: all of it twice a minute, what is young each second.
                next_collect = now + 1.0
                collected += 1
                gc.collect(2 if collected % 30 == 0 else 1)
            wait = next_tick - now if end is None else min(next_tick, end) - now
            actions: Sequence[_Action] = ()
            with self._changed:
                if self._over():
                    return Ended.SOURCES
                self._armed = self._scheduler.next_wakeup()
                if self._armed is not None:
                    wait = min(wait, self._clock.seconds_until(self._armed))
                if wait > 0:
                    self._changed.wait(wait)
                armed, self._armed = self._armed, None
                if armed is not None and self._clock.now() >= armed:
                    actions = self._hand_out(self._scheduler.time(self._clock.now()), None)
            self._run_here(actions, None)
        return Ended.STOPPED

    def _over(self) -> bool:
        return not (self._open_sources or self._remote) and self._scheduler.quiescent()

    def _shut_down(self) -> None:
        self._stop.set()
        with self._lock:
            actions = self._hand_out(self._scheduler.stop(self._clock.now()), None)
            self._unblocked.notify_all()
        self._run_here(actions, None)
        deadline = time.monotonic() + DRAIN_S
        with self._changed:
            while not self._scheduler.quiescent() and time.monotonic() < deadline:
                self._changed.wait(0.02)
            self._scheduler.abandon(self._clock.now())
        for name in self._devices:
            self._guard.interrupt(name)
        for worker in self._threads:
            worker.inbox.put(None)
        threads = [worker.thread for worker in self._threads if worker.thread is not None]
        for thread in [*self._source_threads, *threads]:
            thread.join(max(0.0, deadline + 0.3 - time.monotonic()))
            if thread.is_alive():
                text = f"thread {thread.name} still hangs in a step; left behind"
                self._statistics.event("hung", thread.name, text, self._clock.now())

    # ------------------------------------------------------------------ source threads

    def _read(self, name: str, messages: Iterator[Sampled]) -> None:
        with self._profiler.thread(f"src-{name}"):
            try:
                self._pace(name, messages)
                with self._changed:
                    self._open_sources.discard(name)
                    ended = self._scheduler.source_ended(name, self._clock.now())
                    starts = self._hand_out(ended, None)
                    self._changed.notify_all()
                self._run_here(starts, None)
            except BaseException as error:
                self._crashed(error)

    def _pace(self, name: str, messages: Iterator[Sampled]) -> None:
        """Publish each message when it arrives, until the source ends, fails, or is stopped."""
        port = Port(name)
        while True:
            before = self._profiler.read()
            try:
                message = next(messages, None)
            except Exception as error:
                text = traceback.format_exc()
                with self._lock:
                    self._on_failure(name, error, text, None)
                return
            if message is None:
                return
            if isinstance(message, Message):
                seal(message.payload)
            spent = self._profiler.since(before)
            while (wait := self._clock.seconds_until(message.received)) > 0:
                # A stop is seen within a tick; to wait for it would be ten calls of Python, at
                # every message, on a thread whose caches are cold.
                time.sleep(min(wait, TICK_S))
                if self._stop.is_set():
                    return
            if isinstance(message, Unheard):
                self._say(name, message)
            elif not self._publish(name, port, message, spent):
                return

    def _say(self, name: str, unheard: Unheard) -> None:
        if unheard.text is not None:
            with self._lock:
                self._statistics.event("fault", name, unheard.text, unheard.received)

    def _crashed(self, error: BaseException) -> None:
        """A defect in the scheduler or this driver: end the run; `run` raises it."""
        self._crash = self._crash or error
        self._stop.set()

    def _publish(self, name: str, port: Port, message: Message[Any], spent: Spent) -> bool:
        with self._lock:
            while not self._scheduler.ready(name):
                if self._stop.is_set():
                    return False
                self._blocked_sources += 1
                self._unblocked.wait()
                self._blocked_sources -= 1
            if self._stop.is_set():
                return False
            self._statistics.spent(name, Step.PROCESS, None, spent)  # of making the message alone
            starts = self._hand_out(self._step("publish", port, message, self._clock.now()), None)
        if starts:
            self._run_here(starts, None)
        return True

    # ------------------------------------------------------------------ other processes

    def arrived(self, port: Port, message: Message[Any]) -> None:
        """Another process brings a message; on a thread of the transport."""
        self._brought("arrived", port, message)

    def bounded(self, port: Port, bound: int) -> None:
        """Another process says how far a stream is; `INFINITY` ends it."""
        with self._lock:
            if bound >= INFINITY:
                self._remote.discard(port)
        self._brought("bounded", port, bound)

    def sent(self, runs: Sequence[Run]) -> None:
        """These runs of senders, whose step was `PENDING`, are over."""
        for run in runs:
            with self._lock:
                starts = self._hand_out(self._step("step_done", run, self._clock.now(), ()), None)
                self._changed.notify()
            self._run_here(starts, None)

    def _brought(self, event: str, port: Port, what: Any) -> None:
        with self._lock:
            starts = self._hand_out(self._step(event, port, what, self._clock.now()), None)
        self._run_here(starts, None)

    # ------------------------------------------------------------------ workers

    def _work(self, me: _Thread) -> None:
        with self._profiler.thread(me.name):
            try:
                while (action := me.inbox.get()) is not None:
                    self._run_here([action], me)
            except BaseException as error:
                self._crashed(error)

    def _run_here(self, actions: Sequence[_Action], me: _Thread | None) -> None:
        """Execute steps on this thread, and what they start on it, until nothing is left."""
        todo = deque(actions)
        while todo:
            action = todo.popleft()
            if isinstance(action, Check):
                todo.extend(self._check_here(action.device, me))
                continue
            if isinstance(action, (Bound, Took)):
                assert self._outside is not None
                self._outside.tell(action)
                continue
            run = action.run
            before = self._profiler.read(run.device if action.step is Step.INFER else None)
            failure: tuple[Exception, str] | None = None
            outputs: tuple[Output, ...] = ()
            try:
                said = self._workers[run.stage].execute(run, action.step)
                outputs = () if isinstance(said, Pending) else tuple(said)
            except Exception as error:
                failure = error, traceback.format_exc()
            spent = self._profiler.since(before)
            with self._lock:
                self._statistics.spent(run.stage, action.step, run.device, spent)
                if failure is None and isinstance(said, Pending):
                    continue
                if failure is None:
                    starts = self._step("step_done", run, self._clock.now(), outputs)
                else:
                    starts = self._failed(action, *failure)
                mine = me if me is not None and not action.inline else None
                todo.extend(self._hand_out(starts, mine))

    def _failed(self, start: Start, error: Exception, text: str) -> list[Start]:
        """A step raised: where its device is to blame and another can go on, no run has failed."""
        run, now = start.run, self._clock.now()
        lost = isinstance(error, DeviceError) and start.step is Step.INFER
        if not (lost and self._scheduler.has_later_rung(run)):
            self._on_failure(run.stage, error, text, run.inputs.trigger.stamp)
        elif lost:
            self._statistics.event("device_error", str(run.device), str(error), now)
        return self._step("device_failed" if lost else "step_failed", run, now)

    def _check_here(self, device: str, me: _Thread | None) -> list[_Action]:
        try:
            self._guard.check(device)
        except Exception as error:  # whatever a broken runtime raises, the device is not back
            text = f"still lost: {str(error).strip() or type(error).__name__}"
            with self._lock:
                self._statistics.event("device_check", device, text, self._clock.now())
                starts = self._scheduler.device_checked(device, False, self._clock.now())
                return self._hand_out(starts, me)
        with self._lock:
            starts = self._scheduler.device_checked(device, True, self._clock.now())
            return self._hand_out(starts, me)

    def _step(self, event: str, *arguments: Any) -> list[Start]:
        """Step the scheduler (under the lock), measuring one step in `SAMPLE`."""
        self._steps += 1
        method = getattr(self._scheduler, event)
        if self._steps % SAMPLE:
            return method(*arguments)  # type: ignore[no-any-return]
        before = time.thread_time_ns()
        starts: list[Start] = method(*arguments)
        self._statistics.scheduler_ns += SAMPLE * (time.thread_time_ns() - before)
        return starts

    def _hand_out(self, actions: Sequence[Start | Check], me: _Thread | None) -> list[_Action]:
        """Give each step to its thread (under the lock); returns what this thread executes.

        `me` is the thread whose step just ended: it is free, so it keeps a step it can execute.
        """
        if me is not None and not me.is_device:
            self._idle.append(me)
        inline: list[_Action] = []
        own: list[_Action] = []
        for action in actions:
            if isinstance(action, Check):
                self._guard.interrupt(action.device)
                self._devices[action.device].inbox.put(action)
            elif action.inline:
                inline.append(action)
            elif (thread := self._thread_for(action, me)) is me:
                own.append(action)
            else:
                thread.inbox.put(action)
        if self._blocked_sources:
            self._unblocked.notify_all()
        wakeup = self._scheduler.next_wakeup()
        earlier = wakeup is not None and (self._armed is None or wakeup < self._armed)
        if earlier or self._over():
            self._changed.notify()
        if self._outside is not None:
            inline += self._scheduler.notices()
        return [*inline, *own]

    def _thread_for(self, start: Start, me: _Thread | None) -> _Thread:
        if start.step is Step.INFER:
            return self._devices[str(start.run.device)]
        if me in self._idle:
            self._idle.remove(me)
            return me
        return self._idle.pop()
