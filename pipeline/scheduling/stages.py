"""What the scheduler keeps of one stage, one run, and one select group."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

from pipeline.scheduling.bounds import INFINITY, OutputPort
from pipeline.scheduling.devices import HISTORY, Device
from pipeline.scheduling.edges import Edge
from pipeline.scheduling.events import InputSet, Output, Run, Step
from pipeline.scheduling.ledger import RunBook
from pipeline.scheduling.queue import TriggerQueue
from pipeline.scheduling.sync import Synchronizer, WaitingSet
from pipeline.scheduling.topology import StageNode
from pipeline.scheduling.wanted import Rhythm, Wishes


class ActiveRun(Run):
    """A run with what only the scheduler needs to know of it."""

    __slots__ = ("doomed", "ended", "outputs", "prepared", "prepared_at", "step", "step_started")

    def __init__(self, stage: str, number: int, inputs: InputSet, now: int) -> None:
        self.stage = stage
        self.number = number
        self.inputs = inputs
        self.started = now
        self.device = None
        self.result = None
        self.step: Step | None = None  #: the step that runs now
        self.step_started = now
        self.prepared = False
        self.prepared_at = now
        self.doomed = False  #: its stage stopped or its device is gone: abandoned at its next step
        self.ended: str | None = None  #: how it ended; it leaves once all earlier runs have
        self.outputs: Sequence[Output] = ()

    @property
    def stamp(self) -> int:
        return self.inputs.trigger.stamp


class SelectGroup:
    """Trigger inputs that take the same frames of one output."""

    __slots__ = ("members", "undecided")

    def __init__(self) -> None:
        self.members: list[StageState] = []
        self.undecided: dict[int, WaitingSet] = {}  #: the newest frame, per member (by index)

    def decidable(self) -> bool:
        """A frame is there and every live member has taken the one before."""
        return bool(self.undecided) and not any(
            member.queue.entries and member.live for member in self.members
        )


class StageState:
    """One stage: its ports, its triggers, its sets, its runs."""

    __slots__ = (
        "_prepare_times",
        "blocking",
        "book",
        "cpu_steps",
        "device",
        "dirty",
        "finishing",
        "frames",
        "group",
        "index",
        "inline",
        "inputs",
        "ladder",
        "last_stamp",
        "last_started",
        "live",
        "max_age",
        "max_in_flight",
        "next_number",
        "node",
        "ports",
        "prepare_ns",
        "priority",
        "producer",
        "queue",
        "runs",
        "stateless",
        "stopped",
        "sync",
        "synced_edges",
        "trigger_last",
        "watched",
        "wishes",
    )

    queue: TriggerQueue

    def __init__(self, index: int, node: StageNode) -> None:
        self.index = index
        self.node = node
        # Read on every hop, so kept at hand.
        self.inline = node.inline
        self.stateless = node.stateless
        self.priority = node.priority
        self.max_in_flight = node.max_in_flight
        self.max_age = node.trigger.max_age if node.inputs else None
        self.ports: list[OutputPort] = []
        self.inputs: list[list[Edge]] = []  #: per input, its edges
        self.producer: Edge | None = None  #: the trigger's edge; None for a source
        self.synced_edges: list[Edge] = []  #: all others
        self.blocking: list[Edge] = []  #: out edges whose full queue holds this stage back
        self.sync: Synchronizer | None = None
        self.group: SelectGroup | None = None
        self.ladder: list[Device] = []
        self.device: Device | None = None  #: the first rung of the ladder that is up
        self.live = True  #: takes part in its select group
        self.runs: deque[ActiveRun] = deque()  #: started and not left, in trigger order
        self.finishing: deque[ActiveRun] = deque()  #: inferred, waiting for a worker
        self.cpu_steps = 0  #: steps on CPU workers now
        self.book = RunBook()
        self.next_number = 0
        self.last_started = -1
        self.last_stamp: int | None = None  #: of the trigger of the last started run
        self.stopped = False
        self.dirty = False
        self.watched = False  #: somebody downstream looks at this stage's bounds
        self.trigger_last: int | None = None
        self.wishes: Wishes | None = None  #: with `wanted`: what is wished of it (of its group)
        self.frames = Rhythm()  #: with `wanted`: of its trigger
        self.prepare_ns = 0  #: the greatest of the last measured prepare times
        self._prepare_times: deque[int] = deque(maxlen=HISTORY)

    def stand(self) -> None:
        """Find its rung: a device of the ladder is new, came or went, or the stage stopped."""
        self.device = next((device for device in self.ladder if device.up), None)
        self.live = not self.stopped and (not self.ladder or self.device is not None)

    @property
    def expecting(self) -> bool:
        """A frame may still come that it would take."""
        return not self.stopped and self.producer is not None and not self.producer.origin.ended

    @property
    def degraded(self) -> bool:
        """A run started now would be on a lower rung."""
        return self.device is not None and self.device is not self.ladder[0]

    @property
    def idle(self) -> bool:
        """Nothing is queued, waiting, or ready to go on: there is nothing to start."""
        return not (self.queue.entries or self.finishing or self.sync or self.group)

    @property
    def free(self) -> bool:
        """Has room for one more run."""
        return len(self.runs) < self.max_in_flight

    def measured_prepare(self, took: int) -> None:
        self._prepare_times.append(took)
        self.prepare_ns = max(self._prepare_times)

    def undecided(self) -> WaitingSet | None:
        """The newest frame of the select group, not yet decided for."""
        return self.group.undecided.get(self.index) if self.group else None

    def least_set(self) -> int:
        """The least stamp that a set of this stage may still have (L of README, section 5)."""
        if self.sync is not None and self.sync.waiting:
            return self.sync.waiting[0].stamp
        if self.queue.entries:
            return self.queue.entries[0].stamp
        undecided = self.undecided()
        if undecided is not None:
            return undecided.stamp
        assert self.producer is not None
        return self.producer.origin.bound

    def least_output(self) -> int:
        """The least stamp that may still leave this stage (README, section 1)."""
        if self.stopped:
            return INFINITY
        return self.runs[0].stamp if self.runs else self.least_set()

    def unused(self, edge: Edge) -> int:
        """Messages on an edge that are held and not yet used, counted from what is held."""
        if edge.slot is not None:
            return edge.slot.unused
        waiting = len(self.sync.waiting) if self.sync else 0
        return len(self.queue) + waiting + (self.undecided() is not None)

    def statistics(self) -> dict[str, Any]:
        """What the stage holds now and held at most."""
        if self.producer is None:
            return {}
        waiting = len(self.sync.waiting) if self.sync else 0
        return {"queued": len(self.queue), "queued_peak": self.queue.peak, "waiting": waiting}
