"""What a run measured: rates, ages, latencies, CPU per step, events and failures."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

from pipeline.errors import OverflightError
from pipeline.measuring.profiler import Profiler, Spent
from pipeline.measuring.quantiles import Quantiles
from pipeline.message import Message, Sample
from pipeline.scheduling.events import Observer, Reason, Refusal, Run, Step
from pipeline.scheduling.topology import Port

#: Told of an exception of a stage: its name, the error, the traceback, and the trigger's stamp
#: (None for a source).
OnFailure = Callable[[str, BaseException, str, int | None], None]


#: Ages that the progress line looks at: quantiles of the whole run would take it milliseconds.
RECENT = 31


@dataclass(slots=True)
class PortStatistics:
    """One output port."""

    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    longest_gap_ns: int = 0  #: between two messages
    age_from_stamp: Quantiles = field(default_factory=Quantiles)
    age_from_arrival: Quantiles = field(default_factory=Quantiles)
    lineage: Sequence[Sample] = ()  #: of the last message
    recent_ages: deque[int] = field(default_factory=lambda: deque(maxlen=RECENT))
    age_by_stream: dict[str, Quantiles] = field(default_factory=dict)  #: where several went in

    def note_streams(self, lineage: Sequence[Sample], now: int) -> None:
        """The age of the oldest sample of each sensor that went in."""
        oldest: dict[str, int] = {}
        for sample in lineage:
            if sample.stamp < oldest.get(sample.stream, now + 1):
                oldest[sample.stream] = sample.stamp
        for stream, stamp in oldest.items():
            ages = self.age_by_stream.get(stream)
            if ages is None:
                ages = self.age_by_stream[stream] = Quantiles()
            ages.add(now - stamp)

    def rate_hz(self) -> float | None:
        """Messages a second between the first and the last."""
        if self.count < 2 or self.last_ns <= self.first_ns:
            return None
        return (self.count - 1) * 1e9 / (self.last_ns - self.first_ns)


@dataclass(slots=True)
class StageStatistics:
    """One stage: latency of its runs and the CPU of its steps."""

    latency: Quantiles = field(default_factory=Quantiles)  #: from the trigger's arrival
    queued: Quantiles = field(default_factory=Quantiles)  #: from the trigger's arrival to the start
    ran: Quantiles = field(default_factory=Quantiles)  #: from the start to the end
    cpu_ns: Counter[Step] = field(default_factory=Counter)
    steps: Counter[Step] = field(default_factory=Counter)
    errors: int = 0


@dataclass(frozen=True, slots=True)
class Event:
    """Something a person should know."""

    at_ns: int  #: on the graph's clock
    kind: str
    subject: str
    text: str

    def page(self) -> dict[str, Any]:
        """As plain values, for reports and status pages."""
        return {"at_s": self.at_ns / 1e9, "kind": self.kind, "of": self.subject, "text": self.text}


_stamp = attrgetter("stamp")


class Statistics(Observer):
    """Collects while the graph runs; written under the driver's lock only."""

    def __init__(self, *, offline: bool, profiler: Profiler | None = None) -> None:
        self.offline = offline
        self.profiler = profiler or Profiler()
        self.ports: dict[Port, PortStatistics] = {}
        self.stages: dict[str, StageStatistics] = {}
        self.drops: Counter[Reason] = Counter()
        self.refusals: Counter[Refusal] = Counter()
        #: Told of each event: its kind, its subject, its text, and the graph's time.
        self.on_event: Callable[[str, str, str, int], None] | None = None
        self.events: list[Event] = []
        self.failures: list[str] = []
        self._failed: set[tuple[str, str]] = set()
        self.scheduler_ns = 0

    def published(self, port: Port, message: Message[Any], now: int) -> None:
        statistics = self.ports.get(port)
        if statistics is None:
            statistics = self.ports[port] = PortStatistics(first_ns=now, last_ns=now)
        statistics.count += 1
        gap = now - statistics.last_ns
        if gap > statistics.longest_gap_ns:
            statistics.longest_gap_ns = gap
        statistics.last_ns = now
        statistics.lineage = message.lineage
        if self.offline or not message.lineage:
            return
        oldest = message.lineage[0]
        if len(message.lineage) > 1:
            oldest = min(message.lineage, key=_stamp)
            statistics.note_streams(message.lineage, now)
        age = now - oldest.stamp
        statistics.recent_ages.append(age)
        statistics.age_from_stamp.add(age)
        statistics.age_from_arrival.add(now - oldest.received)

    def refused(self, port: Port, message: Message[Any], reason: Refusal, now: int) -> None:
        if not self.refusals[reason]:
            text = f"refused a message at stamp {message.stamp} ns ({reason}); further ones count"
            self.event("refused", str(port), text, now)
        self.refusals[reason] += 1

    def dropped(
        self, source: Port, stage: str, name: str, message: Message[Any], reason: Reason, now: int
    ) -> None:
        self.drops[reason] += 1

    def run_ended(self, run: Run, how: str, now: int) -> None:
        statistics = self.stage(run.stage)
        if how == "failed":
            statistics.errors += 1
        elif how == "finished" and not self.offline:
            arrived = run.inputs.trigger.received
            statistics.latency.add(now - arrived)
            statistics.queued.add(run.started - arrived)
            statistics.ran.add(now - run.started)

    def event(self, kind: str, subject: str, text: str, now: int) -> None:
        if self.on_event is not None:
            self.on_event(kind, subject, text, now)
        if len(self.events) < 10_000:
            self.events.append(Event(now, kind, subject, text))

    def failed(
        self, stage: str, error: BaseException, text: str, stamp: int | None, now: int
    ) -> None:
        """Keep the first failure of each kind of a stage, with its traceback unless it is ours."""
        ours = isinstance(error, OverflightError)
        kind = type(error).__name__
        if (stage, kind) in self._failed:
            return
        self._failed.add((stage, kind))
        at = "" if stamp is None else f" (first at stamp {stamp / 1e9:.6f} s)"
        sentence = f"{stage}: {error}{at}" if ours else f"{stage}: {kind}: {error}{at}"
        self.failures.append(sentence)
        self.event("failure", stage, sentence if ours else f"{sentence}\n{text.rstrip()}", now)

    def stage(self, name: str) -> StageStatistics:
        statistics = self.stages.get(name)
        if statistics is None:
            statistics = self.stages[name] = StageStatistics()
        return statistics

    def step(self, stage: str, step: Step, cpu_ns: int) -> None:
        """A step took this much CPU time of its thread."""
        statistics = self.stage(stage)
        statistics.cpu_ns[step] += cpu_ns
        statistics.steps[step] += 1

    def spent(self, stage: str, step: Step, device: str | None, spent: Spent) -> None:
        """A step on a device took this."""
        self.step(stage, step, spent.cpu_ns + spent.transfer_ns)
        self.profiler.book(stage, step, device, spent)
