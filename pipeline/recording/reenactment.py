"""Steps a fresh scheduler through recorded events: the one truth of replays and explanations.

Pure as the scheduler itself: no thread, no clock, no file. What follows from each event is compared
with what the recording says; where it is something else, this is another program, another graph, or
the recording was changed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import zip_longest
from typing import Any

from pipeline.errors import DataError
from pipeline.message import Message, Sample
from pipeline.recording.flight import Event, frozen
from pipeline.recording.tap import Row, TappedScheduler
from pipeline.scheduling.events import Check, Observer, Output, Start
from pipeline.scheduling.topology import Port, Topology


class Different(DataError):
    """What follows from a recorded event is not what was recorded."""


class Reenactment:
    """One scheduler on its way through a recording. Use once."""

    def __init__(
        self,
        topology: Topology,
        *,
        offline: bool,
        observer: Observer | None = None,
        on_message: Callable[[Port, Message[Any]], None] | None = None,
    ) -> None:
        """`on_message` gets every message that a port takes."""
        self._on_message = on_message
        self._row: Row = ()
        self._steps = 0
        self.running: dict[int, Start] = {}  #: steps that were started and are not over, by number
        try:
            self.scheduler = TappedScheduler(topology, self, offline=offline, observer=observer)
        except Exception as error:  # of rules that no graph file could give
            what = f"the recorded graph cannot be: {type(error).__name__}: {error}"
            raise DataError(what) from None

    # ------------------------------------------------------------------ as the tap's keeper

    def row(self, row: Row) -> None:
        """What just followed."""
        self._row = row

    def message(self, port: Port, message: Message[Any]) -> bool:
        """A port took a message."""
        if self._on_message is not None:
            self._on_message(port, message)
        return True

    # ------------------------------------------------------------------ events

    def step(
        self, event: Event, payload: Any = None, outputs: Sequence[Output] | None = None
    ) -> list[tuple[int, Start]]:
        """Bring the next event; returns the steps that start, with their numbers.

        `payload` is that of a `publish`; `outputs` are those of a `step_done`, by default the
        recorded ones without their payloads. Raises Different, DataError.
        """
        try:
            actions = self._bring(event, payload, outputs)
        except Exception as error:  # whatever an event that cannot be does to the scheduler
            raise DataError(
                f"event {event.number} ({event.name} at {event.now / 1e9:.6f} s) does not fit the "
                f"recorded graph: {type(error).__name__}: {error}"
            ) from None
        self._compare(event)
        self.scheduler.notices()  # for other processes; here nobody listens, and they would pile up
        started: list[tuple[int, Start]] = []
        for action in actions:
            if not isinstance(action, Check):
                self.running[self._steps] = action
                started.append((self._steps, action))
                self._steps += 1
        return started

    def _bring(
        self, event: Event, payload: Any, outputs: Sequence[Output] | None
    ) -> Sequence[Start | Check]:
        scheduler, name, said, now = self.scheduler, event.name, event.said, event.now
        match name:
            case "publish":
                return scheduler.publish(Port(said[0], said[1]), _message(said, payload, now), now)
            case "arrived":
                return scheduler.arrived(Port(said[0], said[1]), _arrived(said, payload), now)
            case "bounded":
                return scheduler.bounded(Port(said[0], said[1]), said[2], now)
            case "step_done":
                run = self.running.pop(said[0]).run
                made = [Output(port, None, *times) for port, *times in said[1]]
                return scheduler.step_done(run, now, made if outputs is None else outputs)
            case "step_failed" | "device_failed":
                run = self.running.pop(said[0]).run
                return list(getattr(scheduler, name)(run, now))
            case "source_ended" | "device_down" | "device_up" | "device_checked":
                return list(getattr(scheduler, name)(*said, now))
            case "time" | "stop" | "abandon":
                return list(getattr(scheduler, name)(now))
        raise ValueError("an event that this version does not know")

    def _compare(self, event: Event) -> None:
        _, name, _, said, followed = frozen(self._row)
        recorded = tuple(row for row in event.followed if row[0] != "lost")
        if said == event.said and followed == recorded:
            return
        what, one, two = "it says", event.said, said
        if said == event.said:
            what = "what follows"
            rows = zip_longest(recorded, followed)
            one, two = next((one, two) for one, two in rows if one != two)
        raise Different(
            f"event {event.number}, {name} {shown(event.said)} at {event.now / 1e9:.6f} s: {what} "
            f"was {shown(one)} in the flight and is {shown(two)} here"
        )


def shown(row: Any) -> str:
    """A row for people."""
    if row is None:
        return "nothing"
    return " ".join(str(part) for part in row if part not in ((), None)) or "nothing"


def _arrived(said: tuple[Any, ...], payload: Any) -> Message[Any]:
    """A message of another process, as that one took it."""
    *times, received, seq = said
    message = _message(tuple(times), payload, received)
    return replace(message, seq=seq)


def _message(said: tuple[Any, ...], payload: Any, now: int) -> Message[Any]:
    _, _, stamp, before, after, *more = said
    lineage, executor, degraded = more if more else ((), None, False)
    return Message(
        payload,
        stamp,
        stamp + before,
        stamp + after,
        now,
        0,
        tuple(Sample(*sample) for sample in lineage),
        executor,
        degraded,
    )
