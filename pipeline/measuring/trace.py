"""Records what a run did and when, in a ring of bounded size: what `overflight run --trace` writes.

An entry is a flat tuple of numbers and strings: quick to make, no payload is kept alive by it, and
the garbage collector need not look into it. Times are `time.monotonic_ns`, so that a replay at any
speed shows how long things really took; stamps stay on the graph's clock.
"""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from time import monotonic_ns
from typing import Any

from pipeline.drivers.executor import Worker
from pipeline.measuring.trace_entries import KINDS, Entry
from pipeline.message import Message
from pipeline.model import BoundModel
from pipeline.scheduling.events import InputSet, Observer, Output, Reason, Refusal, Run, Step
from pipeline.scheduling.topology import Port, StageNode
from pipeline.stage import Stage

#: Entries kept by default: about three minutes of the paper's graph, in 50 MB.
CAPACITY = 200_000


class Trace(Observer):
    """The last `capacity` entries of a run, and how many there were before them.

    Observer calls come under the driver's lock, steps and samples from any thread without one: they
    rely on `deque.append` and `next(count)` being atomic.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        if capacity < 1:
            raise ValueError(f"a trace keeps at least one entry, not {capacity}")
        self._ring: deque[tuple[Any, ...]] = deque(maxlen=capacity)  #: (number, kind, fields ...)
        self._add = self._ring.append
        self._number = count()
        self._runs: dict[str, int] = {}

    @property
    def recorded(self) -> int:
        """All entries so far."""
        return max((entry[0] for entry in self._ring), default=-1) + 1

    @property
    def overwritten(self) -> int:
        """Entries that newer ones have replaced."""
        return self.recorded - len(self._ring)

    def entries(self) -> list[Entry]:
        """What is kept, in the order in which it was entered. Ask when the run is over."""
        return [KINDS[kind](*fields) for _, kind, *fields in self._ring]

    def save(self, path: Path) -> None:
        """Write what is kept, an entry a line, for a process that draws it. Raises OSError."""
        unfinished = path.with_suffix(".unfinished")
        with unfinished.open("w") as file:
            file.writelines(json.dumps(entry) + "\n" for entry in self._ring)
        unfinished.rename(path)  # it is there whole or not at all

    @classmethod
    def load(cls, path: Path) -> Trace:
        """What another process saved; the file is this project's own. Raises OSError."""
        with path.open() as file:
            entries = [_as_tuple(json.loads(line)) for line in file]
        trace = cls(max(1, len(entries)))
        trace._ring.extend(entries)
        return trace

    # ------------------------------------------------------------------ from the scheduler

    def published(self, port: Port, message: Message[Any], now: int) -> None:
        oldest = {sample.stream: sample.stamp for sample in message.lineage}
        if len(oldest) < len(message.lineage):
            for stream, stamp, _ in message.lineage:
                if stamp < oldest[stream]:
                    oldest[stream] = stamp
        self._add(
            (
                next(self._number),
                "Published",
                monotonic_ns(),
                *port,
                message.seq,
                message.stamp,
                now,
                tuple(oldest.items()),
            )
        )

    def refused(self, port: Port, message: Message[Any], reason: Refusal, now: int) -> None:
        self._add(
            (next(self._number), "Refused", monotonic_ns(), *port, message.stamp, reason.value)
        )

    def dropped(
        self, source: Port, stage: str, name: str, message: Message[Any], reason: Reason, now: int
    ) -> None:
        self._add(
            (
                next(self._number),
                "Dropped",
                monotonic_ns(),
                *source,
                stage,
                name,
                message.seq,
                message.stamp,
                reason.value,
            )
        )

    def set_formed(self, stage: str, inputs: InputSet, now: int) -> None:
        number = self._runs.get(stage, 0)  # sets form in the order of a stage's runs
        self._runs[stage] = number + 1
        self._add(
            (
                next(self._number),
                "SetFormed",
                monotonic_ns(),
                stage,
                number,
                inputs.trigger.stamp,
                inputs.numbers(),
                tuple((name, edge, mark.value) for name, edge, mark in inputs.marks),
            )
        )

    def run_ended(self, run: Run, how: str, now: int) -> None:
        self._add((next(self._number), "RunEnded", monotonic_ns(), run.stage, run.number, how))

    def told(self, kind: str, subject: str, text: str, now: int) -> None:
        """An event of the run, whoever noticed it (not `event`: the scheduler's own alone)."""
        self._add((next(self._number), "Told", monotonic_ns(), kind, subject, text))

    # ------------------------------------------------------------------ from the threads

    def step(self, run: Run, step: Step, began: int, device: str | None) -> None:
        """A step of a run, begun at `began`, is over on this thread."""
        end = monotonic_ns()
        thread = threading.current_thread().name
        self._add(
            (
                next(self._number),
                "Stepped",
                began,
                end,
                run.stage,
                run.number,
                step.value,
                device,
                thread,
            )
        )

    def samples(self, name: str, messages: Iterator[Message[Any]]) -> Iterator[Message[Any]]:
        """The messages of a source, each noted when the driver is back for the next."""
        while True:
            began = monotonic_ns()
            message = next(messages, None)
            if message is None:
                return
            made = monotonic_ns()
            yield message  # a message that is given up before it is published is not recorded
            thread = threading.current_thread().name
            self._add((next(self._number), "Sampled", began, made, monotonic_ns(), name, thread))


def saved_name(process: str, life: int | str) -> str:
    """The file in which a process saves the trace of one of its lives, counted from 1."""
    return f"{process}.{life}.trace"


def _as_tuple(value: Any) -> Any:
    return tuple(_as_tuple(each) for each in value) if isinstance(value, list) else value


class TracedWorker(Worker):
    """A worker whose steps are recorded."""

    def __init__(
        self,
        node: StageNode,
        stage: Stage,
        models: Mapping[str, BoundModel] | None = None,
        *,
        trace: Trace,
    ) -> None:
        super().__init__(node, stage, models)
        self._trace = trace

    def execute(self, run: Run, step: Step) -> Sequence[Output]:
        device = run.device if step is Step.INFER else None  # a lost run gets another meanwhile
        began = monotonic_ns()
        try:
            return super().execute(run, step)
        finally:
            self._trace.step(run, step, began, device)
