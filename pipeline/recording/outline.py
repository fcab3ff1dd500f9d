"""What a replay must know of a recording before it begins: is it complete, what ran, what ended."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from pipeline.recording.flight import Event, Flight
from pipeline.scheduling.topology import Port

#: Events that say that a step was carried out to its end, well or not.
_CAME_BACK = ("step_done", "step_failed")


@dataclass(frozen=True, slots=True)
class Outline:
    """One walk over the decisions of a flight."""

    events: int
    begin: int  #: ns, of the first event
    end: int  #: ns, of the last event
    gap: str | None  #: the first reason why it cannot be re-enacted
    ended: frozenset[int]  #: numbers of the steps that came back
    published: Mapping[Port, int]  #: messages of each port
    ran_on: Mapping[str, frozenset[str]]  #: the devices of each stage's runs

    @classmethod
    def of(cls, flight: Flight, needed: Collection[Port]) -> Outline:
        """Read all decisions; the messages of the `needed` ports must all be there."""
        walk = _Walk(flight, needed)
        for page in flight.pages():
            for event in page.events:
                walk.event(event)
            for lost in page.lost:
                if lost.port in needed:
                    walk.gap = walk.gap or f"{lost.port} at {lost.stamp / 1e9:.6f} s: {lost.why}"
        return cls(
            events=walk.count,
            begin=walk.first,
            end=walk.last.now if walk.last else 0,
            gap=walk.gap if walk.last else "it holds no decisions",
            ended=frozenset(walk.ended),
            published=dict(walk.published),
            ran_on={stage: frozenset(devices) for stage, devices in walk.ran_on.items()},
        )

    def came_back(self, step: int) -> bool:
        """Whether a step was carried out to its end in the flight."""
        return step in self.ended


class _Walk:
    """Gathers an outline, event by event."""

    def __init__(self, flight: Flight, needed: Collection[Port]) -> None:
        self._flight = flight
        self._needed = needed
        self.count = 0
        self.first = 0
        self.last: Event | None = None
        self.gap: str | None = None
        self.ended: list[int] = []
        self.published: Counter[Port] = Counter()
        self.ran_on: dict[str, set[str]] = {}

    def event(self, event: Event) -> None:
        self.gap = self.gap or self._flight.gap(self.last, event)
        if self.last is None:
            self.first = event.now
        if event.name in _CAME_BACK and event.said:
            self.ended.append(event.said[0])
        for kind, *row in event.followed:
            if kind == "out":
                self.published[Port(row[0], row[1])] += 1
            elif kind == "start" and row[3] is not None:
                self.ran_on.setdefault(row[0], set()).add(row[3])
            elif kind == "lost" and Port(row[0], row[1]) in self._needed:
                self.gap = self.gap or (
                    f"the message of {row[0]}/{row[1]} at {row[3] / 1e9:.6f} s was lost: the "
                    "recorder's buffer was full"
                )
        self.last = event
        self.count += 1
