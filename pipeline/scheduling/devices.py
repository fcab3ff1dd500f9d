"""Devices: one infer at a time, one run made ready for it, and when it will be free."""

from __future__ import annotations

from collections import deque
from statistics import median_high
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pipeline.scheduling.stages import ActiveRun, StageState

#: Measurements that a prediction looks back on.
HISTORY = 8


class Device:
    """One device as the scheduler sees it."""

    __slots__ = (
        "_history",
        "_infer_since",
        "_medians",
        "busy_ns",
        "inferring",
        "name",
        "pending",
        "runs",
        "stages",
        "up",
        "waits_ns",
        "wakeup",
    )

    def __init__(self, name: str) -> None:
        self.name = name
        self.up = True
        self.stages: list[StageState] = []  #: those with this device in their ladder, in file order
        self.inferring: ActiveRun | None = None
        self.pending: deque[ActiveRun] = deque()  #: in prepare or prepared; more than one only
        # where another device went down
        self.wakeup: int | None = None  #: when a stage may start its prepare
        self.busy_ns = 0
        self.runs = 0
        self.waits_ns: deque[int] = deque(maxlen=4096)  #: from prepared to infer, per run
        self._infer_since = 0
        self._history: dict[str, deque[int]] = {}
        self._medians: dict[str, int] = {}

    def begin(self, run: ActiveRun, now: int) -> None:
        """The device starts to infer."""
        self.inferring = run
        self._infer_since = now
        self.waits_ns.append(now - run.prepared_at)

    def end(self, run: ActiveRun, now: int) -> None:
        """The infer is over: its time feeds the prediction."""
        took = now - self._infer_since
        self.inferring = None
        self.busy_ns += took
        self.runs += 1
        history = self._history.setdefault(run.stage, deque(maxlen=HISTORY))
        history.append(took)
        self._medians[run.stage] = median_high(history)

    def free_at(self, now: int) -> int:
        """When the running infer is predicted to be over; `now` if none runs or it is overdue."""
        if self.inferring is None:
            return now
        return max(now, self._infer_since + self._medians.get(self.inferring.stage, 0))
