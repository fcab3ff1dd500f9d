"""Runs a graph, whole or cut into parts, in virtual time: steps take no time, no link loses."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from virtual_time import stamps

from pipeline.message import Message
from pipeline.processes.books import merged_ledger
from pipeline.scheduling.bounds import INFINITY
from pipeline.scheduling.events import Bound, InputSet, Observer, Output, Start, Took
from pipeline.scheduling.partition import Part, Placement, part_of
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Port, Role, Topology


class Sets(Observer):
    """The input sets of every stage, in order."""

    def __init__(self) -> None:
        self.by_stage: dict[str, list[tuple[Any, ...]]] = defaultdict(list)

    def set_formed(self, stage: str, inputs: InputSet, now: int) -> None:
        if "@" not in stage:
            values = stamps(inputs.values)
            self.by_stage[stage].append((inputs.trigger.stamp, values, sorted(inputs.marks)))


@dataclass
class Process:
    """What `merged_ledger` reads."""

    name: str
    report: dict[str, Any] | None
    page: dict[str, Any] = field(default_factory=dict)
    past: list[dict[str, Any]] = field(default_factory=list)


class Parts:
    """The parts of one graph, wired to each other."""

    def __init__(self, topology: Topology, placement: Placement) -> None:
        self.topology = topology
        self.placement = placement
        self.sets = Sets()
        self.parts: dict[str, Part] = {
            name: part_of(topology, placement, name) for name in placement.processes()
        }
        self.schedulers = {
            name: Scheduler(part.topology, observer=self.sets) for name, part in self.parts.items()
        }
        self._pending: dict[tuple[str, str], list[Any]] = defaultdict(list)

    def publish(self, port: Port, message: Message[Any], now: int) -> None:
        name = self.placement.process_of[port.stage]
        self._work(name, self.schedulers[name].publish(port, message, now), now)

    def ended(self, source: str, now: int) -> None:
        name = self.placement.process_of[source]
        self._work(name, self.schedulers[name].source_ended(source, now), now)

    def time(self, now: int) -> None:
        for name, scheduler in self.schedulers.items():
            self._work(name, scheduler.time(now), now)

    def next_wakeup(self) -> int | None:
        due = [at for s in self.schedulers.values() if (at := s.next_wakeup()) is not None]
        return min(due, default=None)

    def ledger(self) -> dict[str, dict[str, Any]]:
        """The merged books of all parts."""
        known = []
        for name, scheduler in self.schedulers.items():
            links = {"in": {str(link.port): {"lost": 0} for link in self.parts[name].incoming}}
            report = {"edges": scheduler.ledger(), "links": links, "refused": {}}
            known.append(Process(name, report))
        return merged_ledger(self.topology, self.placement, known)

    def _work(self, name: str, actions: Sequence[Any], now: int) -> None:
        """Execute what starts in a part, and carry what it says to the others."""
        scheduler, part = self.schedulers[name], self.parts[name]
        for action in actions:
            if not isinstance(action, Start):
                continue
            node = part.topology.stage(action.run.stage)
            if node.role is Role.SENDER:
                self._carry(name, node.name, action.run, now)
                continue
            said = [Output(i, f"{node.name}#{action.run.number}") for i in range(len(node.outputs))]
            self._work(name, scheduler.step_done(action.run, now, said), now)
        for notice in scheduler.notices():
            if isinstance(notice, Bound):
                link = next(link for link in part.outgoing if link.sender == notice.sender)
                for target in link.targets:
                    bound = min(notice.bound, INFINITY)
                    self._work(target, self.schedulers[target].bounded(link.port, bound, now), now)
            else:
                self._took(notice, now)

    def _carry(self, name: str, sender: str, run: Any, now: int) -> None:
        link = next(link for link in self.parts[name].outgoing if link.sender == sender)
        message = run.inputs.trigger
        if link.window is not None:
            self._pending[name, sender].append(run)
        for target in link.targets:
            self._work(target, self.schedulers[target].arrived(link.port, message, now), now)
        if link.window is None:
            self._work(name, self.schedulers[name].step_done(run, now, ()), now)

    def _took(self, notice: Took, now: int) -> None:
        name = self.placement.process_of[notice.port.stage]
        for link in self.parts[name].outgoing:
            pending = self._pending[name, link.sender]
            while link.port == notice.port and pending:
                if pending[0].inputs.trigger.seq > notice.seq:
                    break
                done = self.schedulers[name].step_done(pending.pop(0), now, ())
                self._work(name, done, now)


def play(
    parts: Parts, arrivals: Sequence[tuple[int, Port, int]], ends: Sequence[str]
) -> dict[str, list[tuple[Any, ...]]]:
    """Bring (arrival, port, stamp) in order, then end the sources; the sets of every stage."""
    now = 0
    for at, port, stamp in sorted(arrivals):
        while (due := parts.next_wakeup()) is not None and due <= at:
            parts.time(due)
        now = at
        parts.publish(port, Message.at(stamp, str(port)), at)
    for source in ends:
        parts.ended(source, now)
    for _ in range(100):
        if (due := parts.next_wakeup()) is None:
            break
        parts.time(due)
    return dict(parts.sets.by_stage)
