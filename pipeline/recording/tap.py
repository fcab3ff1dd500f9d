"""A scheduler whose every event and every decision is noted: what `--record` writes of a run.

The scheduler is a pure state machine, so the sequence of its events decides everything. The tap
sits in its methods, under the driver's one lock, and makes one flat row of each:

    (number, event, now, arguments, what followed)

Steps are known by their place among all steps that were started: a run that was moved to another
device leaves a run behind whose late result must be told from the new one's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from pipeline.measuring.observers import observed_by
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
)
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Port, Topology

Row = tuple[Any, ...]


class Keeper(Protocol):
    """What takes the rows and the messages; called under the driver's lock, must not block."""

    def row(self, row: Row) -> None:
        """An event with all that followed."""
        ...

    def message(self, port: Port, message: Message[Any]) -> bool:
        """A port took a message; False where it could not be kept."""
        ...


class _Followed(Observer):
    """Gathers what the scheduler does about one event."""

    def __init__(self, keeper: Keeper) -> None:
        self._keep = keeper.message
        self.rows: list[Row] = []

    def published(self, port: Port, message: Message[Any], now: int) -> None:
        self.rows.append(("out", *port, message.seq, message.stamp))
        if not self._keep(port, message):
            self.rows.append(("lost", *port, message.seq, message.stamp))

    def refused(self, port: Port, message: Message[Any], reason: Refusal, now: int) -> None:
        self.rows.append(("refused", *port, message.stamp, reason))

    def dropped(
        self, source: Port, stage: str, name: str, message: Message[Any], reason: Reason, now: int
    ) -> None:
        self.rows.append(("drop", *source, stage, name, message.seq, reason))

    def set_formed(self, stage: str, inputs: InputSet, now: int) -> None:
        self.rows.append(("set", stage, inputs.trigger.stamp, inputs.numbers(), inputs.marks))

    def run_ended(self, run: Run, how: str, now: int) -> None:
        self.rows.append(("end", run.stage, run.number, how))

    def event(self, kind: str, subject: str, text: str, now: int) -> None:
        self.rows.append(("told", kind, subject, text))


class TappedScheduler(Scheduler):
    """The scheduler, noting everything with a keeper; decides exactly as without."""

    def __init__(
        self,
        topology: Topology,
        keeper: Keeper,
        *,
        offline: bool = False,
        observer: Observer | None = None,
    ) -> None:
        followed = _Followed(keeper)
        told = followed if observer is None else observed_by(observer, followed)
        super().__init__(topology, offline=offline, observer=told)
        self._followed = followed
        self._row = keeper.row
        self._events = 0
        self._steps = 0
        self._step_of: dict[Run, int] = {}  #: the last step that was started of each run

    # ------------------------------------------------------------------ events

    def publish(self, port: Port, message: Message[Any], now: int) -> list[Start]:
        m = message
        said: Row = (*port, m.stamp, m.begin - m.stamp, m.end - m.stamp)
        if m.lineage or m.executor or m.degraded:
            said = (*said, m.lineage, m.executor, m.degraded)
        return self._note("publish", now, said, super().publish(port, message, now))

    def arrived(self, port: Port, message: Message[Any], now: int) -> list[Start]:
        m = message
        said: Row = (*port, m.stamp, m.begin - m.stamp, m.end - m.stamp)
        said = (*said, m.lineage, m.executor, m.degraded, m.received, m.seq)
        return self._note("arrived", now, said, super().arrived(port, message, now))

    def bounded(self, port: Port, bound: int, now: int) -> list[Start]:
        return self._note("bounded", now, (*port, bound), super().bounded(port, bound, now))

    def source_ended(self, stage: str, now: int) -> list[Start]:
        return self._note("source_ended", now, (stage,), super().source_ended(stage, now))

    def step_done(self, run: Run, now: int, outputs: Sequence[Output] | None = None) -> list[Start]:
        said = [(o.port, o.stamp, o.begin, o.end) for o in outputs] if outputs else []
        step = self._step_of.pop(run, -1)
        return self._note("step_done", now, (step, said), super().step_done(run, now, outputs))

    def step_failed(self, run: Run, now: int) -> list[Start]:
        step = self._step_of.pop(run, -1)
        return self._note("step_failed", now, (step,), super().step_failed(run, now))

    def time(self, now: int) -> list[Start | Check]:
        return self._note("time", now, (), super().time(now))

    def device_failed(self, run: Run, now: int) -> list[Start]:
        step = self._step_of.pop(run, -1)
        return self._note("device_failed", now, (step,), super().device_failed(run, now))

    def device_checked(self, device: str, ok: bool, now: int) -> list[Start]:
        said = (device, ok)
        return self._note("device_checked", now, said, super().device_checked(device, ok, now))

    def device_down(self, device: str, now: int) -> list[Start]:
        return self._note("device_down", now, (device,), super().device_down(device, now))

    def device_up(self, device: str, now: int) -> list[Start]:
        return self._note("device_up", now, (device,), super().device_up(device, now))

    def stop(self, now: int) -> list[Start]:
        return self._note("stop", now, (), super().stop(now))

    def abandon(self, now: int) -> list[Start]:
        return self._note("abandon", now, (), super().abandon(now))

    # ------------------------------------------------------------------ inside

    def _note(self, event: str, now: int, said: Row, actions: list[Any]) -> list[Any]:
        rows = self._followed.rows
        self._followed.rows = []
        for action in actions:
            if isinstance(action, Check):
                rows.append(("check", action.device))
                continue
            run = action.run
            self._step_of[run] = self._steps
            self._steps += 1
            rows.append(("start", run.stage, run.number, action.step, run.device))
        self._row((self._events, event, now, said, rows))
        self._events += 1
        return actions
