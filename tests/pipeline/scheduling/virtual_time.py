"""Plays a script to one or more schedulers in virtual time and compares them after every event."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count
from pprint import pformat
from typing import Any, NamedTuple, Protocol

from scripts import Arrival, Script

from pipeline.message import Message
from pipeline.scheduling.events import (
    Check,
    InputSet,
    Observer,
    Output,
    Reason,
    Refusal,
    Run,
    Start,
    Step,
)
from pipeline.scheduling.topology import Port, Topology


class Scheduling(Protocol):
    """What a driver needs of a scheduler."""

    def __init__(
        self, topology: Topology, *, offline: bool = False, observer: Observer | None = None
    ) -> None: ...
    def publish(self, port: Port, message: Message[Any], now: int) -> list[Start]: ...
    def step_done(
        self, run: Run, now: int, outputs: Sequence[Output] | None = None
    ) -> list[Start]: ...
    def step_failed(self, run: Run, now: int) -> list[Start]: ...
    def time(self, now: int) -> list[Start | Check]: ...
    def device_failed(self, run: Run, now: int) -> list[Start]: ...
    def device_checked(self, device: str, ok: bool, now: int) -> list[Start]: ...
    def source_ended(self, stage: str, now: int) -> list[Start]: ...
    def device_down(self, device: str, now: int) -> list[Start]: ...
    def device_up(self, device: str, now: int) -> list[Start]: ...
    def stop(self, now: int) -> list[Start]: ...
    def abandon(self, now: int) -> list[Start]: ...
    def ready(self, source: str) -> bool: ...
    def next_wakeup(self) -> int | None: ...
    def quiescent(self) -> bool: ...
    def ledger(self) -> dict[str, dict[str, Any]]: ...
    def runs(self) -> dict[str, dict[str, int]]: ...


class StepKey(NamedTuple):
    """One execution of a step: the same for every scheduler that plays the script."""

    stage: str
    number: int
    step: Step
    device: str | None


class Event(NamedTuple):
    kind: str  #: a method of the scheduler
    subject: Any = None  #: an Arrival, a StepKey, or a name


@dataclass(frozen=True)
class Seen:
    """What one scheduler made of one event, in a form that can be compared."""

    starts: tuple[tuple[Any, ...], ...]
    checks: tuple[str, ...]  #: devices to be checked
    records: tuple[tuple[Any, ...], ...]


@dataclass
class Trace:
    """All events of a script and what followed from each."""

    steps: list[tuple[int, Event, Seen]] = field(default_factory=list)

    def records(self, kind: str) -> list[tuple[Any, ...]]:
        """(now, ...) of every record of this kind, in order."""
        return [
            (now, *record[1:])
            for now, _, seen in self.steps
            for record in seen.records
            if record[0] == kind
        ]


class Mismatch(AssertionError):
    """Two schedulers differ, or one breaks a law, with the whole story up to there."""

    def __init__(self, script: Script, trace: Trace, what: str) -> None:
        story = [str(script)]
        for now, event, seen in trace.steps:
            story.append(f"{now}: {event.kind} {event.subject or ''}")
            story += [f"      {row}" for row in (*seen.records, *seen.starts)]
        super().__init__("\n".join([*story, what]))


#: Events whose subject the rules name, too.
COMPARED_EVENTS = ("device_down", "device_up", "device_hung", "device_failed", "wish_missed")


def stamps(value: Any) -> Any:
    """A set's value with stamps for messages."""
    if isinstance(value, tuple):
        return tuple(map(stamps, value))
    return value.stamp if isinstance(value, Message) else value


def _set(inputs: InputSet) -> tuple[Any, ...]:
    return inputs.trigger.stamp, stamps(inputs.values), tuple(sorted(inputs.marks))


class Player(Observer):
    """One scheduler, the runs that it handed out, and what it told of the event at hand."""

    def __init__(self, kind: type[Scheduling], script: Script) -> None:
        self.scheduler = kind(script.topology, offline=script.offline, observer=self)
        self.handed_out: dict[StepKey, Run] = {}
        self.told: list[tuple[Any, ...]] = []
        self.script = script

    def feed(self, event: Event, now: int) -> Seen:
        self.told = []
        method = getattr(self.scheduler, event.kind)
        if isinstance(event.subject, Arrival):
            arrival = event.subject
            message = Message(str(arrival.port), arrival.stamp, arrival.begin, arrival.end, now)
            actions = method(arrival.port, message, now)
        elif isinstance(event.subject, StepKey):
            run = self.handed_out[event.subject]
            last = event.kind == "step_done" and event.subject.step in (Step.PROCESS, Step.FINISH)
            actions = method(run, now, self._outputs(run)) if last else method(run, now)
        elif isinstance(event.subject, tuple):
            actions = method(*event.subject, now)
        else:
            actions = method(now) if event.subject is None else method(event.subject, now)
        starts = [action for action in actions if isinstance(action, Start)]
        checks = tuple(action.device for action in actions if isinstance(action, Check))
        for start in starts:
            self.handed_out[key_of(start)] = start.run
        told = ((*key_of(start), *_set(start.run.inputs), start.inline) for start in starts)
        return Seen(tuple(told), checks, tuple(self.told))

    def _outputs(self, run: Run) -> list[Output]:
        behavior, node = self.script.behaviors[run.stage], self.script.topology.stage(run.stage)
        saying, trigger = behavior.says[run.number % len(behavior.says)], run.inputs.trigger
        count = {"none": 0, "one": min(1, len(node.outputs))}.get(saying, len(node.outputs))
        shift = {"later": behavior.later, "below": -1}.get(saying)
        stamp = None if shift is None else trigger.stamp + shift
        return [Output(port, f"{run.stage}#{run.number}", stamp) for port in range(count)]

    def published(self, port: Port, message: Message[Any], now: int) -> None:
        lineage = tuple((s.stream, s.stamp, s.received) for s in message.lineage)
        times = message.stamp, message.begin, message.end, message.received, message.seq
        made = message.payload, message.executor, message.degraded
        self.told.append(("published", str(port), *times, lineage, *made))

    def refused(self, port: Port, message: Message[Any], reason: Refusal, now: int) -> None:
        self.told.append(("refused", str(port), message.stamp, reason.value))

    def dropped(
        self, source: Port, stage: str, name: str, message: Message[Any], reason: Reason, now: int
    ) -> None:
        edge = f"{source}->{stage}/{name}"
        self.told.append(("dropped", edge, message.stamp, reason.value))

    def set_formed(self, stage: str, inputs: InputSet, now: int) -> None:
        self.told.append(("set", stage, *_set(inputs)))

    def run_ended(self, run: Run, how: str, now: int) -> None:
        self.told.append(("ended", run.stage, run.number, how))

    def event(self, kind: str, subject: str, text: str, now: int) -> None:
        if kind in ("stale", "recovered"):
            self.told.append((kind,))
        elif kind in COMPARED_EVENTS:
            self.told.append((kind, subject))

    def books(self) -> dict[str, Any]:
        edges = {
            key: {**book, "dropped": {str(r): n for r, n in book["dropped"].items() if n}}
            for key, book in self.scheduler.ledger().items()
        }
        sources = [node.name for node in self.script.topology.stages if node.is_source]
        return {
            "edges": edges,
            "runs": self.scheduler.runs(),
            "ready": {source: self.scheduler.ready(source) for source in sources},
            "quiescent": self.scheduler.quiescent(),
        }


def key_of(start: Start) -> StepKey:
    run = start.run
    return StepKey(run.stage, run.number, start.step, run.device)


def unbalanced(books: dict[str, Any]) -> list[str]:
    """The edges and stages whose books do not balance."""
    wrong = []
    for key, book in books["edges"].items():
        if (
            book["produced"]
            != book["delivered"] + sum(book["dropped"].values()) + book["in_flight"]
        ):
            wrong.append(f"{key}: {book}")
    for stage, book in books["runs"].items():
        if book["started"] != sum(count for kind, count in book.items() if kind != "started"):
            wrong.append(f"{stage}: {book}")
    return wrong


class Drive:
    """One playing of a script. The first scheduler leads: its starts decide what happens next."""

    def __init__(self, script: Script, *kinds: type[Scheduling]) -> None:
        self.script, self.trace = script, Trace()
        self.players = [Player(kind, script) for kind in kinds]
        self.leader = self.players[0].scheduler
        self.heap: list[tuple[int, int, int, Event]] = []
        self.count = count()
        self.checks = count()
        self.waking: set[int] = set()
        self.late: dict[str, deque[Event]] = {
            node.name: deque() for node in script.topology.stages if node.is_source
        }

    def play(self) -> Trace:
        if self.script.offline:
            self._play_offline()
        else:
            self._play_live()
        books = self.players[0].books()
        if not books["quiescent"] or any(book["in_flight"] for book in books["edges"].values()):
            raise Mismatch(self.script, self.trace, f"not at rest in the end: {pformat(books)}")
        return self.trace

    def _play_live(self) -> None:
        for arrival in self.script.arrivals:
            self._push(arrival.at, Event("publish", arrival))
        names = {"down": "device_down", "up": "device_up", "ended": "source_ended"}
        for happening in self.script.happenings:
            event = Event(names.get(happening.kind, happening.kind), happening.name or None)
            self._push(happening.at, event)
        now = self._run_heap(0)
        for device in sorted({d for node in self.script.topology.stages for d in node.devices}):
            self._push(now, Event("device_up", device))
        for source in self.late:
            self._push(now, Event("source_ended", source))
        self._run_heap(now)

    def _run_heap(self, now: int) -> int:
        while self.heap:
            now, _, _, event = heapq.heappop(self.heap)
            source = event.subject.port.stage if event.kind == "publish" else event.subject
            waits = self.script.patient and event.kind in ("publish", "source_ended")
            if waits and (self.late[source] or not self.leader.ready(source)):
                self.late[source].append(event)
                continue
            self._feed(event, now)
            for source, queue in self.late.items():
                while queue and self.leader.ready(source):
                    self._feed(queue.popleft(), now)
            for player in self.players:  # each is woken when it asks: lateness counts
                wakeup = player.scheduler.next_wakeup()
                if wakeup is not None and wakeup not in self.waking:
                    self.waking.add(wakeup)
                    self._push(wakeup, Event("time"))
        return now

    def _play_offline(self) -> None:
        sources = {name: deque[Arrival]() for name in self.late}
        for arrival in self.script.arrivals:
            sources[arrival.port.stage].append(arrival)
        now, order = 0, list(sources)
        while sources or self.heap:
            if self.heap:
                now, _, _, event = heapq.heappop(self.heap)
                self._feed(event, now)
                continue
            ended = next((name for name, queue in sources.items() if not queue), None)
            if ended is not None:
                del sources[ended]
                self._feed(Event("source_ended", ended), now)
                continue
            name = min(sources, key=lambda name: (sources[name][0].stamp, order.index(name)))
            self._feed(Event("publish", sources[name].popleft()), now)

    def _push(self, at: int, event: Event) -> None:
        rank = int(isinstance(event.subject, StepKey) is not self.script.steps_first)
        heapq.heappush(self.heap, (at, rank, next(self.count), event))

    def _feed(self, event: Event, now: int) -> None:
        promised = [player.scheduler.next_wakeup() for player in self.players]
        first, *others = [player.feed(event, now) for player in self.players]
        self.trace.steps.append((now, event, first))
        books, *other_books = [player.books() for player in self.players]
        for seen, kept in zip(others, other_books, strict=True):
            self._compare("starts", sorted(seen.starts, key=repr), sorted(first.starts, key=repr))
            self._compare("checks", seen.checks, first.checks)
            self._compare("told", sorted(seen.records, key=repr), sorted(first.records, key=repr))
            for part, book in books.items():
                self._compare(part, kept[part], book)
        if wrong := unbalanced(books):
            raise Mismatch(self.script, self.trace, f"unbalanced: {wrong}")
        if event.kind == "time" and (first.starts or first.checks or first.records):
            for player, wakeup in zip(self.players, promised, strict=True):
                if wakeup is None or wakeup > now:
                    name = type(player.scheduler).__name__
                    raise Mismatch(self.script, self.trace, f"{name} would sleep till {wakeup}")
        for device in first.checks:
            lasts, works = self.script.check(next(self.checks))
            self._push(now + lasts, Event("device_checked", (device, works)))
        for start in first.starts:
            key = StepKey(*start[:4])
            self._push(now + self._lasts(key), Event(self._outcome(key), key))

    def _compare(self, what: str, got: Any, expected: Any) -> None:
        if got != expected:
            text = f"{what} differ\n got      {pformat(got)}\n expected {pformat(expected)}"
            raise Mismatch(self.script, self.trace, text)

    def _lasts(self, key: StepKey) -> int:
        behavior = self.script.behaviors[key.stage]
        durations = {Step.INFER: behavior.infer, Step.FINISH: behavior.finish}
        lasting = durations.get(key.step, behavior.first)
        return lasting[key.number % len(lasting)]

    def _outcome(self, key: StepKey) -> str:
        says = self.script.behaviors[key.stage].says
        saying = says[key.number % len(says)]
        first, last = (
            key.step in (Step.PROCESS, Step.PREPARE),
            key.step in (Step.PROCESS, Step.FINISH),
        )
        ladder = self.script.topology.stage(key.stage).devices
        lost = saying == "lost all" or (saying == "lost" and key.device in ladder[:1])
        if key.step is Step.INFER and lost:
            return "step_failed" if self.script.offline else "device_failed"
        fails = {"raise early": first, "raise": last, "raise infer": key.step is Step.INFER}
        return "step_failed" if fails.get(saying) else "step_done"


def drive(script: Script, *kinds: type[Scheduling]) -> Trace:
    """Play a script to all `kinds`, in step; raises Mismatch."""
    return Drive(script, *kinds).play()
