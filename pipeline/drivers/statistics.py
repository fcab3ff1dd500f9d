"""What a run measured: rates, ages, latencies, CPU per step, events and failures."""

from __future__ import annotations

from array import array
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

from pipeline.errors import OverflightError
from pipeline.message import Message
from pipeline.scheduling.events import Observer, Reason, Refusal, Run, Step
from pipeline.scheduling.topology import Port

#: Values kept for quantiles. At 30 Hz that is half an hour; later ones replace random earlier ones.
RESERVOIR = 1 << 16


#: Told of an exception of a stage: its name, the error, the traceback, and the trigger's stamp
#: (None for a source).
OnFailure = Callable[[str, BaseException, str, int | None], None]


#: Ages that the progress line looks at: quantiles of the whole run would take it milliseconds.
RECENT = 31


class Quantiles:
    """A bounded sample of integers with exact count and quantiles over what is kept."""

    __slots__ = ("_state", "_values", "count")

    def __init__(self) -> None:
        self._values = array("q")
        self.count = 0
        self._state = 1

    def add(self, value: int) -> None:
        self.count += 1
        if len(self._values) < RESERVOIR:
            self._values.append(value)
            return
        # A linear congruential step is random enough to choose whom to replace, and repeatable.
        self._state = (self._state * 6364136223846793005 + 1442695040888963407) & (2**64 - 1)
        place = (self._state >> 16) % self.count
        if place < RESERVOIR:
            self._values[place] = value

    def at(self, fraction: float) -> int | None:
        """The nearest-rank quantile; None while empty."""
        if not self._values:
            return None
        ordered = sorted(self._values)
        return ordered[min(int(fraction * len(ordered)), len(ordered) - 1)]


def milliseconds(quantiles: Quantiles) -> dict[str, float | None]:
    """p50 and p99 in ms."""
    values = {"p50": quantiles.at(0.50), "p99": quantiles.at(0.99)}
    return {name: None if ns is None else round(ns / 1e6, 3) for name, ns in values.items()}


@dataclass(slots=True)
class PortStatistics:
    """One output port."""

    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    age_from_stamp: Quantiles = field(default_factory=Quantiles)
    age_from_arrival: Quantiles = field(default_factory=Quantiles)
    recent_ages: deque[int] = field(default_factory=lambda: deque(maxlen=RECENT))

    def rate_hz(self) -> float | None:
        """Messages a second between the first and the last."""
        if self.count < 2 or self.last_ns <= self.first_ns:
            return None
        return (self.count - 1) * 1e9 / (self.last_ns - self.first_ns)


@dataclass(slots=True)
class StageStatistics:
    """One stage: latency of its runs and the CPU of its steps."""

    latency: Quantiles = field(default_factory=Quantiles)
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


_stamp = attrgetter("stamp")


class Statistics(Observer):
    """Collects while the graph runs; written under the driver's lock only."""

    def __init__(self, *, offline: bool) -> None:
        self.offline = offline
        self.ports: dict[Port, PortStatistics] = {}
        self.stages: dict[str, StageStatistics] = {}
        self.drops: Counter[Reason] = Counter()
        self.refusals: Counter[Refusal] = Counter()
        self.events: list[Event] = []
        self.failures: list[str] = []
        self._failed: set[tuple[str, str]] = set()
        self.scheduler_ns = 0

    def published(self, port: Port, message: Message[Any], now: int) -> None:
        statistics = self.ports.get(port)
        if statistics is None:
            statistics = self.ports[port] = PortStatistics(first_ns=now)
        statistics.count += 1
        statistics.last_ns = now
        if self.offline or not message.lineage:
            return
        oldest = message.lineage[0]
        if len(message.lineage) > 1:
            oldest = min(message.lineage, key=_stamp)
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
            statistics.latency.add(now - run.inputs.trigger.received)

    def event(self, kind: str, subject: str, text: str, now: int) -> None:
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
