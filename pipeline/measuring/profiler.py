"""Where the CPU time of a run goes: steps of stages, native pools, device processes, the rest.

A step costs what its thread's CPU clock says, and for an infer also what the device took beside it:
the threads that appeared, or worked, while its models were built and warmed up (a device runs one
infer at a time, so what they take meanwhile is this infer's), or its own process. Then the thread
that calls only moves data: `transfer`. Threads that several devices use, as all OpenVINO models
of a process use one pool, are one line of their own, never split by guess.

Every clock is a kernel's thread or process clock; `process_time` around a call would count what all
others do meanwhile (2 to 5 times too much was seen).
"""

from __future__ import annotations

import contextlib
import gc
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple, Self

from pipeline.drivers.threads import name_this_thread, name_thread
from pipeline.measuring.cpu_clocks import (
    Child,
    Meter,
    OurThread,
    PoolMeter,
    ProcessMeter,
    thread_name,
    thread_ns,
    threads,
)
from pipeline.measuring.cpu_time import CpuTime, StepCost
from pipeline.scheduling.events import Step

#: A pool has come to rest when none of its clocks moved for this long; how long to wait for that.
REST_S, MOST_RESTS = 0.002, 25


class Reading(NamedTuple):
    """The clocks at the start of a step."""

    device: str | None  #: whose meter was read, too
    wall_ns: int
    cpu_ns: int
    beside_ns: int


class Spent(NamedTuple):
    """What one step took."""

    wall_ns: int
    cpu_ns: int  #: for the stage's work
    transfer_ns: int = 0  #: to carry data to a device's process and back
    own_ns: int = 0  #: of all that: of the thread that executed the step


class Profiler:
    """Books the CPU time of one run: `building` while it is opened, then `start` to `stop`, all
    within its `with` block."""

    def __init__(self) -> None:
        self.costs: dict[str, dict[tuple[str | None, Step], StepCost]] = {}  #: by stage
        self._pools: dict[str, set[int]] = {}  #: native threads by device, and by stage
        self._children: dict[str, Child] = {}  #: by device
        self._meters: dict[str, Meter] = {}  #: by device
        self._shared: dict[str, Meter] = {}  #: by the names of those that share
        self._stages: dict[str, Meter] = {}  #: threads that a stage started in `open`
        self._beside: Counter[str] = Counter()  #: of each meter, what infers took
        self._own_ns = 0  #: of steps, on our threads
        self._ours: list[OurThread] = []
        self._running = False
        self._collected: dict[int, int] = {}  #: garbage collection, ns by thread
        self._collecting_since = 0
        self._progress_ns = 0
        self._process_ns = 0
        self._before: dict[int, int] = {}  #: every thread's clock when the run began

    def __enter__(self) -> Self:
        gc.callbacks.append(self._collecting)
        return self

    def __exit__(self, *error: object) -> None:
        gc.callbacks.remove(self._collecting)

    # ------------------------------------------------------------------ before the run

    @contextlib.contextmanager
    def building(self, owner: str, child: Child | None = None) -> Iterator[None]:
        """Threads that appear or work meanwhile belong to `owner`, a device or a stage; a
        `child` is a process instead."""
        if child is not None:
            self._children[owner] = child
            yield
            if self._running and owner not in self._meters:
                self._meters[owner] = ProcessMeter(child)
            return
        if not self._running:
            self._rest()
        before = {tid: thread_ns(tid) for tid in threads()}
        python = {thread.native_id for thread in threading.enumerate()}
        try:
            yield
        finally:
            found = {tid for tid in threads() if tid not in before}
            if not self._running:  # while a graph runs, its other pools work, too
                old = threads() & set(before) - python
                found |= {tid for tid in old if thread_ns(tid) != before[tid]}
            self._pools.setdefault(owner, set()).update(found)
            meter = self._meters.setdefault(owner, PoolMeter(())) if self._running else None
            if isinstance(meter, PoolMeter):
                meter.add(found)

    def _rest(self) -> None:
        """Wait until the pools known so far have stopped to spin, or their time would count for
        the next owner."""
        known = sorted(set().union(*self._pools.values()))
        for _ in range(MOST_RESTS if known else 0):
            before = [thread_ns(tid) for tid in known]
            time.sleep(REST_S)
            if [thread_ns(tid) for tid in known] == before:
                return

    # ------------------------------------------------------------------ the run

    def start(self, devices: Iterable[str]) -> None:
        """Begin to count, on the thread that drives the run. `devices` are those of the graph; any
        other owner of threads is a stage."""
        devices = set(devices)
        users: dict[int, set[str]] = {}
        for owner, tids in self._pools.items():
            for tid in tids:
                users.setdefault(tid, set()).add(owner)
        groups: dict[tuple[str, ...], list[int]] = {}
        for tid, owners in users.items():
            groups.setdefault(tuple(sorted(owners)), []).append(tid)
        for names, together in groups.items():
            for tid in together:  # a runtime leaves its threads the name of the process
                name_thread(tid, f"of-{'-'.join(names)}")
            if len(names) > 1:
                self._shared["threads of " + " and ".join(names)] = PoolMeter(together)
            else:
                kind = self._meters if names[0] in devices else self._stages
                kind[names[0]] = PoolMeter(together)
        for name, child in self._children.items():
            self._meters[name] = ProcessMeter(child)
        self._collected.clear()
        for thread in self._ours:  # those that are there already, of other processes' messages
            thread.begin()
        self._ours.append(OurThread(time.thread_time_ns()))
        self._before = {tid: thread_ns(tid) or 0 for tid in threads()}
        self._process_ns = time.process_time_ns()
        self._running = True

    @contextlib.contextmanager
    def thread(self, name: str) -> Iterator[None]:
        """The calling thread is one of the framework's until the end of the block."""
        name_this_thread(name)
        thread = OurThread(0)
        self._ours.append(thread)
        try:
            yield
        finally:
            thread.end()

    def enter_thread(self) -> None:
        """The calling thread is new and one of the framework's; it keeps its Python name."""
        name_this_thread(threading.current_thread().name)
        self._ours.append(OurThread(0))

    def read_threads(self) -> None:
        """Read the clocks of the framework's threads, before they end by themselves."""
        for thread in self._ours:
            thread.read()

    def read(self, device: str | None = None) -> Reading:
        """The clocks before a step; `device`, where it infers."""
        meter = None if device is None else self._meters.get(device)
        beside = 0 if meter is None else meter.ns()
        return Reading(device, time.monotonic_ns(), self._thread_ns(), beside)

    def since(self, before: Reading) -> Spent:
        """What the step took, on the same thread."""
        own = self._thread_ns() - before.cpu_ns
        wall = time.monotonic_ns() - before.wall_ns
        device = before.device
        if device is None or (meter := self._meters.get(device)) is None:
            return Spent(wall, own, 0, own)
        beside = meter.ns() - before.beside_ns
        self._beside[device] += beside  # one infer at a time, so one thread at a time
        if device in self._children:
            return Spent(wall, beside, own, own)
        return Spent(wall, own + beside, 0, own)

    def book(self, stage: str, step: Step, device: str | None, spent: Spent) -> None:
        """Enter a step (under the driver's lock)."""
        costs = self.costs.setdefault(stage, {})
        cost = costs.get((device, step))
        if cost is None:
            cost = costs[device, step] = StepCost()
        cost.count += 1
        cost.cpu_ns += spent.cpu_ns
        cost.transfer_ns += spent.transfer_ns
        cost.wall.add(spent.wall_ns)
        cost.cpu.add(spent.cpu_ns + spent.transfer_ns)
        self._own_ns += spent.own_ns

    @contextlib.contextmanager
    def showing(self) -> Iterator[None]:
        """What happens meanwhile shows the run and is no part of it."""
        before = self._thread_ns()
        try:
            yield
        finally:
            self._progress_ns += self._thread_ns() - before

    def _thread_ns(self) -> int:
        """The calling thread's CPU time without the garbage collector's."""
        return time.thread_time_ns() - self._collected.get(threading.get_ident(), 0)

    def _collecting(self, phase: str, info: Mapping[str, int]) -> None:
        now = time.thread_time_ns()
        if phase == "start":
            self._collecting_since = now
        else:
            thread = threading.get_ident()
            took = now - self._collecting_since
            self._collected[thread] = self._collected.get(thread, 0) + took

    # ------------------------------------------------------------------ after it

    def stop(self, scheduler_ns: int) -> CpuTime:
        """End the count, on the thread that started it. `scheduler_ns` of it were the scheduler's,
        an estimate."""
        self.read_threads()
        total = time.process_time_ns() - self._process_ns
        self._running = False
        ours = sum(thread.ns for thread in self._ours)
        collector = sum(self._collected.values())
        between = ours - self._own_ns - collector - self._progress_ns
        taken = {name: meter.ns() for name, meter in self._meters.items()}
        processes = {name: taken[name] for name in self._children}
        stages = {
            stage: sum(cost.cpu_ns + cost.transfer_ns for cost in costs.values())
            for stage, costs in self.costs.items()
        }
        for stage, meter in self._stages.items():
            stages[stage] = stages.get(stage, 0) + meter.ns()
        shared = {name: meter.ns() for name, meter in self._shared.items()}
        for device, ns in taken.items():
            rest = ns - self._beside[device]
            users = [s for s, costs in self.costs.items() if (device, Step.INFER) in costs]
            if len(users) == 1:
                stages[users[0]] += rest
                self.costs[users[0]][device, Step.INFER].cpu_ns += rest
            else:
                shared[f"{device} between its runs"] = rest
        scheduler = max(0, min(scheduler_ns, between))
        return CpuTime(
            total=total + sum(processes.values()),
            stages=stages,
            shared={name: ns for name, ns in shared.items() if ns > 0},
            scheduler=scheduler,
            drivers=between - scheduler,
            collector=collector,
            progress=self._progress_ns,
            processes=processes,
            strangers=self._strangers(),
        )

    def _strangers(self) -> dict[str, int]:
        """Living threads that nobody owns, and what they took."""
        owned = set().union(*self._pools.values()) | {thread.tid for thread in self._ours}
        found: Counter[str] = Counter()
        for tid in threads() - owned:
            found[thread_name(tid)] += (thread_ns(tid) or 0) - self._before.get(tid, 0)
        return {name: ns for name, ns in found.items() if ns > 0}
