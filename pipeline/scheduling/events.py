"""What goes into the scheduler and what comes out of it.

Into it (methods of the scheduler; each takes `now` and returns the actions that follow, in order):

    publish(port, message, now)       a source brings a message
    step_done(run, result, now)       a step of a run is over
    step_failed(run, now)             a step of a run raised
    time(now)                         a wake-up
    source_ended(stage, now)          a source's iterator is exhausted
    arrived(port, message, now)       another process brings a message of a port of its own
    bounded(port, bound, now)         another process says how far a port of its own is
    device_failed(run, now)           the infer of a run raised: the device is lost
    device_checked(device, ok, now)   the answer to a `Check`
    device_down(device, now) / device_up(device, now)
    stop(now)                         start nothing more; what is queued or waits ends here
    abandon(now)                      give up the runs that are still going

Out of it: `Start` actions (what to execute), `Check` actions from `time`, notices for other
processes (`notices`), and, through an `Observer`, what happened.

The values made on every hop are named tuples: frozen like our dataclasses, and 0.2 us to make
instead of 0.4 us (a hop makes five).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

from pipeline.message import Message
from pipeline.scheduling.topology import Port


class Step(StrEnum):
    """The parts of a run. A stage without a model has `process` only."""

    PROCESS = "process"
    PREPARE = "prepare"
    INFER = "infer"
    FINISH = "finish"


class Reason(StrEnum):
    """Why a message that nobody used ended on an edge (the ledger's words)."""

    REPLACED = "replaced"
    QUEUE_FULL = "queue_full"
    PASSED_OVER = "passed_over"
    DECIMATED = "decimated"
    NOT_WANTED = "not_wanted"
    TOO_OLD = "too_old"
    SET_SKIPPED = "set_skipped"
    LOST_IN_TRANSPORT = "lost_in_transport"
    STAGE_STOPPED = "stage_stopped"
    END = "end"


class Refusal(StrEnum):
    """Why a port did not take a message: never fatal, counted in the port's book."""

    BACKWARD = "backward"  #: stamp not above the port's last
    EARLY = "early"  #: stamp below the bound that the source promised
    EXTENT = (
        "extent"  #: begin or end further from the stamp than MAX_EXTENT_NS, or on its wrong side
    )
    ENDED = "ended"  #: the stream has ended


class Mark(StrEnum):
    """What a set says of an input whose value is not the settled one."""

    UNSETTLED = "unsettled"
    MISSING = "missing"
    HELD = "held"


#: One edge's share of a set: a message, None, or (span) a tuple of messages.
Value = Message[Any] | tuple[Message[Any], ...] | None


class InputSet(NamedTuple):
    """The messages of one run."""

    trigger: Message[Any]
    values: tuple[Any, ...]  #: one per input in signature order; a tuple of Values where `many`
    marks: tuple[tuple[str, int, Mark], ...] = ()  #: (input, edge number in it, mark)

    def numbers(self) -> tuple[Any, ...]:
        """The numbers of its messages (`seq`), in the shape of `values`."""
        return tuple(map(_numbers, self.values))


def _numbers(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_numbers, value))
    return None if value is None else value.seq


@dataclass(slots=True, eq=False)
class Run:
    """One run of a stage: owned by the scheduler, handed to the executor and back.

    `result` is what one step leaves for the next (tensors, outputs); it belongs to the executor.
    """

    stage: str
    number: int  #: from 0, in trigger order
    inputs: InputSet
    started: int  #: when its first step was started, ns
    device: str | None = None  #: the device its infer takes
    result: Any = None


class Start(NamedTuple):
    """Execute this step of this run now: on a CPU worker, on `run.device` (infer), or inline."""

    run: Run
    step: Step
    inline: bool = False


class Check(NamedTuple):
    """Find out whether a lost device works again, on the thread that infers on it."""

    device: str


class Bound(NamedTuple):
    """For another process: no message below `bound` will be sent by this sender any more."""

    sender: str
    bound: int


class Took(NamedTuple):
    """For the process of a remote port: a stage with ``policy: block`` took all up to `seq`."""

    port: Port
    stage: str
    seq: int


#: What other processes should know.
Notice = Bound | Took


class Output(NamedTuple):
    """What a finished run says on one output port."""

    port: int  #: index in the stage's outputs
    payload: Any
    stamp: int | None = None  #: None: the trigger's, with its extent
    begin: int | None = None
    end: int | None = None


class Observer:
    """Told of everything that happens; every method does nothing until overridden.

    Called inside the scheduler's step, so it must be quick and must not call back.
    """

    def published(self, port: Port, message: Message[Any], now: int) -> None:
        """A port took a message."""

    def refused(self, port: Port, message: Message[Any], reason: Refusal, now: int) -> None:
        """A port did not take a message."""

    def dropped(
        self, source: Port, stage: str, name: str, message: Message[Any], reason: Reason, now: int
    ) -> None:
        """A message ended unused on the edge from `source` to input `name` of `stage`."""

    def set_formed(self, stage: str, inputs: InputSet, now: int) -> None:
        """A run starts with these inputs."""

    def run_ended(self, run: Run, how: str, now: int) -> None:
        """A run is over: "finished", "filtered", "failed" or "abandoned"."""

    def event(self, kind: str, subject: str, text: str, now: int) -> None:
        """Something a person should know: a stream went stale or recovered, a stage stopped ..."""
