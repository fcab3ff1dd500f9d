"""The message side of the reference: ports, queues, select groups and sync slots by definition.

Sections 1 to 5 and 9 of pipeline/scheduling/README.md in plain loops. It keeps everything that ever
arrived and works everything out anew whenever it is asked, so that a reader can check it against
that page. Slow on purpose.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any, NamedTuple

from pipeline.message import MAX_EXTENT_NS, Message
from pipeline.scheduling.events import InputSet, Mark, Observer, Output, Reason, Refusal, Run, Step
from pipeline.scheduling.topology import Input, Missing, Policy, Port, StageNode, Sync, Topology

CAP, SPAN_CAP, WAITING_SETS = 64, 4096, 4
DEFAULT_WAIT = 200_000_000
HELD_TRIGGER = ("queue", "undecided", "decided", "waiting")


@dataclass(eq=False)
class Item:
    """A message on one edge, from its arrival on, forever."""

    message: Message[Any]
    s: int  #: effective stamp
    arrived: int
    place: str = ""  #: one of HELD_TRIGGER, "slot", or "": not held
    fate: Reason | None = None
    uses: int = 0
    kept: bool = False  #: it came to its trigger or slot: not decimated on the edge, nor too late
    gap: int = 0  #: to the one kept before
    verdict: str = ""  #: at a `wanted` trigger: "every", "must", "may" or "no"


@dataclass(eq=False)
class Edge:
    source: Port
    node: StageNode
    input: Input
    number: int
    items: list[Item] = field(default_factory=list)
    stale: bool = False

    def held(self, *places: str) -> list[Item]:
        return [item for item in self.items if item.place in places]


@dataclass(eq=False)
class Job:
    """A run and where it stands; `how` is known before it leaves when an earlier one is going."""

    run: Run
    step: Step
    running: bool = False
    since: int = 0  #: start of the step
    how: str = ""
    left: bool = False
    doomed: bool = False  #: abandoned when its step returns
    outputs: Sequence[Output] = ()

    @property
    def stamp(self) -> int:
        return self.run.inputs.trigger.stamp


@dataclass
class Outlet:
    bound: float = -inf
    stamps: list[int] = field(default_factory=list)  #: of all that it took
    promised: bool = True

    @property
    def last(self) -> float:
        return self.stamps[-1] if self.stamps else -inf


class Choice(NamedTuple):
    shares: dict[Edge, tuple[list[Item], Mark | None]]
    timed_out: list[Edge]
    skip: bool


class Streams:
    def __init__(
        self, topology: Topology, *, offline: bool = False, observer: Observer | None = None
    ) -> None:
        self.offline, self.observer = offline, observer or Observer()
        self.nodes, self.workers = topology.stages, topology.workers
        self.node = {node.name: node for node in self.nodes}
        self.outlets = {
            Port(node.name, name): Outlet() for node in self.nodes for name in node.outputs
        }
        self.edges = [
            Edge(source, node, entry, number)
            for node in self.nodes
            for entry in node.inputs
            for number, source in enumerate(entry.sources)
        ]
        self.jobs: dict[str, list[Job]] = {node.name: [] for node in self.nodes}
        self.ended: set[str] = set()  # sources
        self.stopped: set[str] = set()  # stages
        self.down: set[str] = set()  # devices
        self.stopping = False
        self.now = 0

    # 1. Ports

    def _refusal(self, port: Port, message: Message[Any]) -> Refusal | None:
        outlet, stamp = self.outlets[port], message.stamp
        if port.stage in self.ended:
            return Refusal.ENDED
        if not self._extent_holds(message):
            return Refusal.EXTENT
        if stamp <= outlet.last:
            return Refusal.BACKWARD
        return Refusal.EARLY if stamp < outlet.bound else None

    def _extent_holds(self, message: Message[Any]) -> bool:
        begin, stamp, end = message.begin, message.stamp, message.end
        return stamp - MAX_EXTENT_NS <= begin <= stamp <= end <= stamp + MAX_EXTENT_NS

    def _bound(self, port: Port) -> float:
        node, outlet = self.node[port.stage], self.outlets[port]
        if node.name in self.ended | self.stopped:
            return inf
        if node.is_source:
            return outlet.bound
        going = [job.stamp for job in self._in_flight(node)]
        return max(outlet.last + 1, min([self._least(node), *going]))

    def _least(self, node: StageNode) -> float:
        """L: the least stamp that a set of the stage may still have."""
        trigger = self._trigger(node)
        return min([item.s for item in trigger.held(*HELD_TRIGGER)] + [self._bound(trigger.source)])

    # 2. A message arrives on its edges

    def _send(self, port: Port, message: Message[Any]) -> None:
        outlet = self.outlets[port]
        message = replace(message, seq=len(outlet.stamps))
        outlet.stamps.append(message.stamp)
        promise = self.node[port.stage].min_period if outlet.promised else None
        outlet.bound = max(outlet.bound, message.stamp + (promise or 1))
        self.observer.published(port, message, self.now)
        for edge in self.edges:
            if edge.source == port:
                self._arrive(edge, Item(message, message.stamp + edge.input.offset, self.now))

    def _arrive(self, edge: Edge, item: Item) -> None:
        before, entry = edge.items[:], edge.input
        edge.items.append(item)
        kept = [other.s for other in before if other.kept]
        if edge.node.name in self.stopped:
            self._drop(edge, item, Reason.STAGE_STOPPED)
        elif self.stopping:
            self._drop(edge, item, Reason.END)
        elif (
            entry.period
            and kept
            and item.s < kept[-1] + entry.period - (item.s - before[-1].s) // 2
        ):
            self._drop(edge, item, Reason.DECIMATED)
        else:
            item.kept, item.gap = True, item.s - kept[-1] if kept else 0
            if entry.sync is Sync.TRIGGER:
                self._enqueue(edge, item)
            else:
                self._into_slot(edge, item)

    def _into_slot(self, edge: Edge, item: Item) -> None:
        item.place = "slot"
        if edge.stale and item.s > max(self._timed_out_triggers(edge), default=-inf):
            edge.stale = False
            self.observer.event("recovered", str(edge.source), "", self.now)
        if len(edge.held("slot")) > self._cap(edge):
            self._drop(edge, edge.held("slot")[0], Reason.QUEUE_FULL)

    def _cap(self, edge: Edge) -> float:
        return inf if self.offline else SPAN_CAP if edge.input.sync is Sync.SPAN else CAP

    def _timed_out_triggers(self, edge: Edge) -> list[int]:
        arrivals = (t for t in self._trigger(edge.node).items if t.kept)
        return [t.s for t in arrivals if self._deadline(edge, t) <= self.now]

    def _drop(self, edge: Edge, item: Item, reason: Reason) -> None:
        """The item leaves; silently when it was used."""
        item.place = ""
        if not item.uses:
            item.fate = reason
            entry = edge.input.name
            self.observer.dropped(
                edge.source, edge.node.name, entry, item.message, reason, self.now
            )

    # 3. and 4. Trigger queues and select groups

    def _enqueue(self, edge: Edge, item: Item) -> None:
        entry, queue = edge.input, edge.held("queue")
        item.place = "queue"
        if self.offline or entry.policy is Policy.BLOCK:
            return
        if entry.select is not None:
            item.place = "undecided"
            for older in edge.held("undecided")[:-1]:
                self._drop(edge, older, Reason.REPLACED)
        elif entry.policy is Policy.LATEST:
            for older in queue:
                self._drop(edge, older, Reason.REPLACED)
        elif len(queue) >= entry.size:
            full = item if entry.policy is Policy.DROP_NEWEST else queue[0]
            self._drop(edge, full, Reason.QUEUE_FULL)

    def _blocked(self, node: StageNode) -> bool:
        return not self.offline and any(
            edge.source.stage == node.name
            and edge.node.name not in self.stopped
            and edge.input.policy is Policy.BLOCK
            and edge.input.sync is Sync.TRIGGER
            and len(edge.held("queue")) + len(self._in_flight(node)) >= edge.input.size
            for edge in self.edges
        )

    def _group(self, edge: Edge) -> list[Edge]:
        """The trigger edges that take the same frames as this one; itself without `select`."""
        if edge.input.select is None:
            return [edge]
        of = edge.source, edge.input.select
        return [other for other in self.edges if (other.source, other.input.select) == of]

    def _members(self, edge: Edge) -> list[Edge]:
        """Those of a group's live members."""
        return [other for other in self._group(edge) if self._live(other.node)]

    def _live(self, node: StageNode) -> bool:
        if node.is_source or node.name in self.stopped:
            return False
        return not node.devices or self._device(node) is not None

    def _head(self, node: StageNode) -> Item | None:
        edge = self._trigger(node)
        heads = edge.held("queue", "decided")
        if not heads and not any(member.held("decided") for member in self._members(edge)):
            heads = edge.held("undecided") if self._live(node) else []
        return heads[0] if heads else None

    def _take(self, node: StageNode, item: Item) -> None:
        """Taking an undecided frame decides it for its group."""
        if item.place != "undecided":
            return
        for edge in self._group(self._trigger(node)):
            for frame in edge.held("undecided"):
                if self._live(edge.node):
                    frame.place = "decided"
                else:
                    self._drop(edge, frame, Reason.REPLACED)

    # 5. Sync slots

    def _deadline(self, edge: Edge, trigger: Item) -> float:
        wait = edge.input.max_wait
        if wait is None:
            wait = 2 * trigger.gap or DEFAULT_WAIT
        return inf if self.offline else trigger.arrived + wait

    def _verdict(self, edge: Edge, T: int, lo: int, hi: int) -> tuple[bool, list[Item]]:
        """Whether the slot is settled, and the best that it has."""
        entry, held = edge.input, edge.held("slot")
        bound = self._bound(edge.source) + entry.offset
        if entry.sync is Sync.EXACT:
            found = [item for item in held if item.s == T]
            return bool(found) or bound > T, found
        if entry.sync is Sync.LATEST:
            return not self.offline or bound > T, [item for item in held if item.s <= T][-1:]
        if entry.sync is Sync.NEAREST:
            near = [item for item in held if abs(item.s - T) <= entry.tolerance]
            best = sorted(near, key=lambda item: (abs(item.s - T), item.s))[:1]
            proven = bound > T + entry.tolerance or any(bound >= T + abs(b.s - T) for b in best)
            return proven, best
        after = [item for item in held if item.s >= hi]
        first = [item for item in held if item.s <= lo][-1:] or held[:1]
        last = after[:1] or held[-1:]
        return bool(after) or bound == inf, [i for i in held if first[0].s <= i.s <= last[0].s]

    def _choose(self, node: StageNode, trigger: Item) -> Choice | None:
        """What the oldest set of the stage would start with; None while it waits."""
        T, lo, hi = trigger.s, trigger.message.begin, trigger.message.end
        choice, skip = Choice({}, [], False), False
        for edge in sorted(self._slots(node), key=lambda edge: edge.input.sync is Sync.SPAN):
            entry = edge.input
            settled, found = self._verdict(edge, T, lo, hi)
            expired = self.now >= self._deadline(edge, trigger)
            if not (settled or edge.stale or expired or self._forced(node)):
                return None
            if expired and not settled and not edge.stale:
                choice.timed_out.append(edge)
            mark = None if settled else Mark.UNSETTLED
            if not found and entry.missing is Missing.HOLD:
                found = [i for i in edge.held("slot") if 0 <= T - i.s <= entry.hold][-1:]
                mark = Mark.HELD
            if not found:
                mark, skip = Mark.MISSING, skip or entry.missing is Missing.SKIP
            if entry.sync is not Sync.SPAN:
                lo = min([lo, *(item.message.begin + entry.offset for item in found)])
                hi = max([hi, *(item.message.end + entry.offset for item in found)])
            choice.shares[edge] = found, mark
        return choice._replace(skip=skip)

    def _forced(self, node: StageNode) -> bool:
        """A fifth trigger forces the oldest set."""
        full = len(self._trigger(node).held("waiting")) == WAITING_SETS
        return full and not self.offline and self._has_room(node) and self._head(node) is not None

    def _useless(self, edge: Edge, item: Item, n: float) -> bool:
        """Whether no set will take it; `n` is the stamp of the next one held, else inf."""
        L, s, entry = self._least(edge.node), item.s, edge.input
        if inf == L:
            return True
        if entry.missing is Missing.HOLD and s <= L < n:
            return False
        if entry.sync is Sync.EXACT:
            return s < L
        if entry.sync is Sync.NEAREST:
            return s < L - entry.tolerance or L - s > n - L
        return n <= (L if entry.sync is Sync.LATEST else self._floor(edge, L) - MAX_EXTENT_NS)

    def _floor(self, span: Edge, L: float) -> float:
        """The least effective stamp that a set may still hold beside what is in `span`."""
        floors = [L]
        for edge in self._slots(span.node):
            held, entry = edge.held("slot"), edge.input
            if edge is span or entry.sync is Sync.SPAN:
                continue
            if entry.sync is Sync.NEAREST:
                floors.append(L - entry.tolerance)
            if entry.sync is Sync.LATEST:
                floors.append(held[0].s if held else self._bound(edge.source) + entry.offset)
            if entry.missing is Missing.HOLD:
                floors.append(L - entry.hold)
        return min(floors)

    def _prune(self) -> bool:
        for edge in self.edges:
            held = edge.held("slot")
            for item, n in zip(held, [*(after.s for after in held[1:]), inf], strict=False):
                if self._useless(edge, item, n):
                    self._drop(edge, item, Reason.PASSED_OVER)
                    return True
        return False

    def _mark_stale(self, edges: list[Edge]) -> None:
        for edge in edges:
            edge.stale = True
            self.observer.event("stale", str(edge.source), "", self.now)

    def _input_set(self, node: StageNode, trigger: Item, choice: Choice) -> InputSet:
        values: list[Any] = []
        marks: list[tuple[str, int, Mark]] = []
        for entry in node.inputs:
            value: list[Any] = []
            for edge in self.edges:
                if edge.node is node and edge.input is entry:
                    found, mark = choice.shares.get(edge, ([trigger], None))
                    messages = tuple(item.message for item in found)
                    single = messages[0] if messages else None
                    value.append((messages or None) if entry.sync is Sync.SPAN else single)
                    marks += [(entry.name, edge.number, mark)] if mark else []
            values.append(tuple(value) if entry.many else value[0])
        return InputSet(trigger.message, tuple(values), tuple(marks))

    # What the rules speak of

    def _trigger(self, node: StageNode) -> Edge:
        return next(e for e in self.edges if e.node is node and e.input.sync is Sync.TRIGGER)

    def _slots(self, node: StageNode) -> list[Edge]:
        return [e for e in self.edges if e.node is node and e.input.sync is not Sync.TRIGGER]

    def _in_flight(self, node: StageNode) -> list[Job]:
        return [job for job in self.jobs[node.name] if not job.left]

    def _all_in_flight(self) -> list[Job]:
        return [job for node in self.nodes for job in self._in_flight(node)]

    def _has_room(self, node: StageNode) -> bool:
        halted = self.stopping or node.name in self.stopped
        return not halted and len(self._in_flight(node)) < node.max_in_flight

    def _device(self, node: StageNode) -> str | None:
        return next((device for device in node.devices if device not in self.down), None)

    def _messages(self, inputs: InputSet) -> list[Message[Any]]:
        """The messages of a set, in its order."""
        flat: list[Any] = list(inputs.values)
        while any(isinstance(value, tuple) for value in flat):
            flat = [v for value in flat for v in (value if isinstance(value, tuple) else [value])]
        return [value for value in flat if value is not None]

    def _drop_everything(self, edges: list[Edge], reason: Reason) -> None:
        for edge in edges:
            for item in edge.held("slot", *HELD_TRIGGER):
                self._drop(edge, item, reason)

    # 9. The ledger

    def ledger(self) -> dict[str, dict[str, Any]]:
        return {
            f"{edge.source}->{edge.node.name}/{edge.input.name}": {
                "produced": len(edge.items),
                "delivered": sum(item.uses > 0 for item in edge.items),
                "reused": sum(max(item.uses - 1, 0) for item in edge.items),
                "dropped": dict(Counter(i.fate.value for i in edge.items if i.fate is not None)),
                "in_flight": sum(bool(item.place) and not item.uses for item in edge.items),
            }
            for edge in self.edges
        }
