"""Runs a graph in virtual time from a cost table: the scheduler is the real one, the work is not.

What is modeled, and nothing else: sensors send at their rates; a step takes a draw of a log-normal
distribution through the p50 and p99 of the table, never beyond three standard deviations; a device
is held for its infer; CPU workers and the host's part of an infer share the cores (processor
sharing: where more is asked for than there are cores, the computing part of every step slows down
alike). What the table does not hold costs nothing. Threads change hands in no time: what that, the
GIL and the caches cost is in the table's times as far as it was in the steps that were measured.
"""

from __future__ import annotations

import heapq
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import repeat
from typing import Any, NamedTuple, TypeAlias
from zlib import crc32

import numpy as np

from pipeline.drivers.arrivals import MS, arrivals
from pipeline.graph.graph import Graph
from pipeline.measuring.costs import Costs, Spread
from pipeline.measuring.report import build_report
from pipeline.measuring.statistics import Statistics
from pipeline.message import Message
from pipeline.scheduling.events import Check, Output, Start, Step
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Policy, Port, Topology

#: Draws made at once.
BLOCK = 4096
#: No draw lies further from the median, in standard deviations of the logarithm.
FURTHEST = 3.0


class Bar(NamedTuple):
    """One step in the schedule."""

    stage: str
    step: Step
    device: str | None  #: of an infer; None: on a CPU worker
    begin: int  #: ns of virtual time
    end: int


@dataclass(frozen=True, slots=True)
class Plan:
    """What a virtual run says."""

    report: dict[str, Any]  #: as a measured run's; its wall time is the virtual one
    busy: dict[str, float]  #: by stage: the share of time in which a CPU step of it was under way
    bars: tuple[Bar, ...]  #: the steps that ended in the recorded part
    events: int  #: messages, ended steps and wake-ups


def run_plan(
    graph: Graph,
    costs: Costs,
    *,
    seconds: float,
    cores: int | None = None,
    seed: int = 0,
    record_s: tuple[float, float] = (0.0, 0.0),
) -> Plan:
    """Run `graph` for `seconds` of virtual time; `record_s`: the part whose schedule is kept.

    `costs` must hold every source; a stage without an entry costs nothing. The same seed gives the
    same plan.
    """
    statistics = Statistics(offline=False)
    cores = cores or costs.machine.cores
    topology = replace(graph.topology, workers=cores + 1)
    virtual = _Virtual(
        topology, costs, cores, seed, Scheduler(topology, observer=statistics), record_s
    )
    virtual.run(seconds)
    virtual.fill(statistics)
    own: dict[str, dict[str, float]] = {node.name: {} for node in topology.stages}
    wall_ns = round(seconds * 1e9)
    steps_ns = sum(sum(page.cpu_ns.values()) for page in statistics.stages.values())
    framework_ns = round((virtual.events - virtual.wakeups) * costs.machine.event_us * 1e3)
    report = build_report(
        replace(graph, topology=topology),
        virtual.scheduler,
        statistics,
        own=own,
        devices={name: {} for name in virtual.scheduler.devices()},
        wall_ns=wall_ns,
        cpu_ns=steps_ns + framework_ns,
        offline=False,
    )
    busy_ns = virtual.busy_ns()
    busy = {name: busy_ns[name] / wall_ns for name in own}
    return Plan(report, busy, tuple(virtual.bars), virtual.events)


#: Messages that a full queue holds back, by source.
Late: TypeAlias = dict[str, deque[tuple[Port, Message[None]]]]


class _StepModel:
    """One step of one stage on one device, and what it has taken so far."""

    __slots__ = ("computes", "cores", "count", "draws", "under_way_ns", "used_ns", "waits")

    def __init__(self, draws: Iterator[int], cores: float) -> None:
        self.draws = draws  #: ns, undisturbed
        self.cores = cores  #: asked for while it runs
        self.waits = max(0.0, 1.0 - cores)  #: the share of it that no other step slows down
        self.computes = min(1.0, cores)  #: the share that slows down with the cores
        self.count = 0
        self.used_ns = 0.0  #: CPU
        self.under_way_ns = 0


class _Running(NamedTuple):
    """A step under way, in the order in which steps end."""

    end: int
    number: int
    begin: int
    start: Start
    model: _StepModel
    undisturbed: int  #: ns


class _Virtual:
    """One scheduler, driven through virtual time. Use once."""

    def __init__(
        self,
        topology: Topology,
        costs: Costs,
        cores: int,
        seed: int,
        scheduler: Scheduler,
        record_s: tuple[float, float],
    ) -> None:
        self._topology, self._costs, self._seed = topology, costs, seed
        self._cores = cores
        self._record = (round(record_s[0] * 1e9), round(record_s[1] * 1e9))
        self.scheduler = scheduler
        self.bars: list[Bar] = []
        self.events = 0
        self.wakeups = 0
        self._models: dict[tuple[str, Step, str | None], _StepModel] = {}
        self._running: list[_Running] = []  # a heap
        self._numbers = 0
        self._slowness = 1.0  #: by how much computing takes longer now
        self._outputs = {
            node.name: tuple(Output(port, None) for port in range(len(node.outputs)))
            for node in topology.stages
        }
        names = [node.name for node in topology.stages if node.is_source]
        found = {name: costs.of(name, None) for name in names}
        self._source_ms = {
            name: 0.0 if cost is None else cost.cpu(Step.PROCESS) for name, cost in found.items()
        }
        #: Sensors are read on threads of their own: a steady load.
        self._load = sum(ms / costs.sources[name].period_ms for name, ms in self._source_ms.items())
        self._patient = {
            edge.stage
            for node in topology.stages
            for entry in node.inputs
            for edge in entry.sources
            if entry.policy is Policy.BLOCK
        }

    def run(self, seconds: float) -> None:
        """Bring every event at its instant."""
        scheduler = self.scheduler
        late: Late = {}
        end = round(seconds * 1e9)
        stream = arrivals(self._topology, self._costs.sources, seconds, self._seed)
        for arrival, port, message in stream:
            if arrival >= end:
                break
            self._until(arrival, late)
            source = port.stage
            if source in self._patient and (source in late or not scheduler.ready(source)):
                late.setdefault(source, deque()).append((port, message))
                continue
            self.events += 1
            self._begin(scheduler.publish(port, message, arrival), arrival)
        self._until(end, late)
        for left in self._running:
            self._book(left, end)

    def _until(self, instant: int, late: Late) -> None:
        """Every step that ends, and every wake-up, no later than `instant`."""
        scheduler, running = self.scheduler, self._running
        while True:
            now = running[0].end if running else instant + 1
            wakeup = scheduler.next_wakeup()
            if wakeup is not None and wakeup <= min(now, instant):
                now = wakeup
                self.events += 1
                self.wakeups += 1
                self._begin(scheduler.time(now), now)
            elif now <= instant:
                self._ended(heapq.heappop(running))
            else:
                return
            if late:
                self._catch_up(late, now)

    def _catch_up(self, late: Late, now: int) -> None:
        """Bring what was held back, as far as there is room again."""
        for source, waiting in list(late.items()):
            while waiting and self.scheduler.ready(source):
                port, message = waiting.popleft()
                self.events += 1
                self._begin(self.scheduler.publish(port, message, now), now)
            if not waiting:
                del late[source]

    def _begin(self, actions: list[Start] | list[Start | Check], now: int) -> None:
        asked = 0.0
        for action in actions:
            if isinstance(action, Check):  # no device fails here; one that was given up is back
                self._begin(self.scheduler.device_checked(action.device, True, now), now)
                continue
            run = action.run
            key = run.stage, action.step, run.device
            model = self._models.get(key)
            if model is None:
                model = self._models[key] = self._model(*key)
            takes = next(model.draws)
            slowed = round(takes * (model.waits + model.computes * self._slowness))
            self._numbers += 1
            heapq.heappush(
                self._running, _Running(now + slowed, self._numbers, now, action, model, takes)
            )
            asked += model.cores
        if asked:
            self._asked(asked, now)

    def _ended(self, step: _Running) -> None:
        now, run = step.end, step.start.run
        self.events += 1
        self._book(step, now)
        last = step.start.step in (Step.PROCESS, Step.FINISH)
        said = self._outputs[run.stage] if last else None
        if step.model.cores:
            self._asked(-step.model.cores, now)
        self._begin(self.scheduler.step_done(run, now, said), now)

    def _book(self, step: _Running, now: int) -> None:
        """Enter what a step took, all of it or, at the end, what it has taken so far."""
        model, under_way = step.model, now - step.begin
        model.count += 1
        model.under_way_ns += under_way
        if now == step.end:
            model.used_ns += step.undisturbed * model.cores
        else:
            model.used_ns += step.undisturbed * model.cores * under_way / (step.end - step.begin)
        if self._record[0] < now and step.begin < self._record[1]:
            run, which = step.start.run, step.start.step
            device = run.device if which is Step.INFER else None
            self.bars.append(Bar(run.stage, which, device, step.begin, now))

    def _asked(self, cores: float, now: int) -> None:
        """The load has changed: where it is beyond the cores, all that runs ends at other times."""
        self._load += cores
        slowness = max(1.0, self._load / self._cores)
        before, self._slowness = self._slowness, slowness
        if abs(slowness - before) < 1e-9:
            return
        running = self._running
        for place, step in enumerate(running):
            waits, computes = step.model.waits, step.model.computes
            factor = (waits + computes * slowness) / (waits + computes * before)
            running[place] = step._replace(end=now + round((step.end - now) * factor))
        heapq.heapify(running)

    def _model(self, stage: str, step: Step, device: str | None) -> _StepModel:
        cost = self._costs.of(stage, device)
        if cost is None or (time := cost.time(step)) is None or not time.mean:
            return _StepModel(repeat(0), 0.0)
        # Not by device: assignments that are compared get the same draws.
        seed = self._seed + crc32(f"{stage} {step}".encode())
        return _StepModel(_draws(time, seed), cost.cpu(step) / time.mean)

    def fill(self, statistics: Statistics) -> None:
        """Enter the CPU of every step."""
        for (stage, step, _), model in self._models.items():
            page = statistics.stage(stage)
            page.cpu_ns[step] += round(model.used_ns)
            page.steps[step] += model.count
        for source, ms in self._source_ms.items():
            page, port = statistics.stage(source), statistics.ports.get(Port(source))
            page.steps[Step.PROCESS] = port.count if port else 0
            page.cpu_ns[Step.PROCESS] = round(page.steps[Step.PROCESS] * ms * MS)

    def busy_ns(self) -> Counter[str]:
        """By stage, how long steps of it were under way on CPU workers."""
        busy: Counter[str] = Counter()
        for (stage, step, _), model in self._models.items():
            busy[stage] += model.under_way_ns if step is not Step.INFER else 0
        return busy


def _draws(time: Spread, seed: int) -> Iterator[int]:
    """ns, without end."""
    if not time.sigma:
        yield from repeat(round(time.p50 * MS))
    random = np.random.default_rng(seed)
    while True:
        z = np.clip(random.standard_normal(BLOCK), -FURTHEST, FURTHEST)
        yield from np.rint(time.p50 * MS * np.exp(time.sigma * z)).astype(np.int64).tolist()
