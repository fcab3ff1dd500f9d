"""Relates the entries of a recorded run: which run used and made which message, in which steps."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from pipeline.measuring.trace_entries import (
    Chosen,
    Entry,
    Published,
    RunEnded,
    Sampled,
    SetFormed,
    Stepped,
)
from pipeline.scheduling.topology import Sync, Topology

RunKey: TypeAlias = tuple[str, int]  #: (stage, number)
MessageKey: TypeAlias = tuple[str, str, int]  #: (stage, port, number)


@dataclass(frozen=True, slots=True)
class Use:
    """One edge's share of an input set."""

    name: str  #: the input, and where it takes several edges which one
    is_trigger: bool
    keys: Sequence[MessageKey]  #: none, one, or those of a span
    last: Published | None  #: the last of them, if it is still in the trace


class Relations:
    """What a trace still holds; what was overwritten is missing in all of them."""

    def __init__(self, entries: Sequence[Entry], topology: Topology) -> None:
        self.nodes = {node.name: node for node in topology.stages}
        self.published: dict[MessageKey, Published] = {}
        self.made_by: dict[MessageKey, RunKey] = {}
        self.samples: list[tuple[Sampled, Published]] = []
        self.sets: dict[RunKey, SetFormed] = {}
        self.steps: dict[RunKey, list[Stepped]] = defaultdict(list)
        self.ended: dict[RunKey, RunEnded] = {}
        said: dict[str, list[Published]] = defaultdict(list)  #: since the stage's last run
        for entry in entries:
            match entry:
                case Published():
                    self.published[entry.stage, entry.port, entry.seq] = entry
                    said[entry.stage].append(entry)
                case SetFormed():
                    self.sets[entry.stage, entry.number] = entry
                case Stepped():
                    self.steps[entry.stage, entry.number].append(entry)
                case RunEnded():  # follows what the run says
                    self.ended[entry.stage, entry.number] = entry
                    for message in said.pop(entry.stage, ()):
                        key = (message.stage, message.port, message.seq)
                        self.made_by[key] = entry.stage, entry.number
                case Sampled():
                    self.samples += [(entry, message) for message in said.pop(entry.stage, ())]
                case _:
                    pass
        for steps in self.steps.values():
            steps.sort()

    def uses(self, formed: SetFormed) -> Iterator[Use]:
        """Each edge of the stage, and what the set has of it."""
        for rule, chosen in zip(self.nodes[formed.stage].inputs, formed.chosen, strict=True):
            several = rule.many and isinstance(chosen, tuple)
            each = chosen if several and isinstance(chosen, tuple) else (chosen,)
            for source, numbers in zip(rule.sources, each, strict=True):
                keys = [(*source, number) for number in _flat(numbers)]
                name = f"{rule.name} from {source}" if several else rule.name
                last = self.published.get(keys[-1]) if keys else None
                yield Use(name, rule.sync is Sync.TRIGGER, keys, last)


def _flat(numbers: Chosen) -> tuple[int, ...]:
    if isinstance(numbers, tuple):
        return tuple(number for each in numbers for number in _flat(each))
    return () if numbers is None else (numbers,)
