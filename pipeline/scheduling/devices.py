"""Devices: one infer at a time, one run made ready for it, and when it will be free."""

from __future__ import annotations

from collections import deque
from statistics import median_high
from typing import TYPE_CHECKING

from pipeline.scheduling.bounds import INFINITY

if TYPE_CHECKING:
    from pipeline.scheduling.stages import ActiveRun, StageState

#: Measurements that a prediction looks back on.
HISTORY = 8
#: An infer is overdue after so many times the longest of the last `LONGEST_OF`; not below the
#: floor, by which a busy machine may delay the shortest; and so late before one is measured.
OVERDUE_FACTOR = 10
LONGEST_OF = 64
OVERDUE_FLOOR_NS = 100_000_000
OVERDUE_FIRST_NS = 10_000_000_000
#: A device that is lost again within so many pauses after its return is checked half as often, down
#: to a `LONGEST_PAUSE`-th.
STEADY_PAUSES = 10
LONGEST_PAUSE = 32


class Usage:
    """What one stage took of a device."""

    __slots__ = ("busy_ns", "runs", "waits_ns")

    def __init__(self) -> None:
        self.runs = 0
        self.busy_ns = 0
        self.waits_ns: deque[int] = deque(maxlen=4096)  #: from prepared to infer, per run


class Device:
    """One device as the scheduler sees it."""

    __slots__ = (
        "_check_every",
        "_history",
        "_infer_since",
        "_longest",
        "_medians",
        "_pause",
        "_up_since",
        "check_due",
        "checking",
        "inferring",
        "name",
        "overdue_at",
        "pending",
        "shut",
        "stages",
        "up",
        "usage",
        "wakeup",
    )

    def __init__(self, name: str, check_every: int) -> None:
        self.name = name
        self.up = True
        self.checking = False  #: a check is under way
        self.check_due: int | None = None  #: when the next check is due; None: none is
        self.overdue_at: int | None = None  #: when the running infer is given up
        self.stages: list[StageState] = []  #: those with this device in their ladder, in file order
        self.inferring: ActiveRun | None = None
        self.pending: deque[ActiveRun] = deque()  #: in prepare or prepared; more than one only
        # where another device went down
        self.wakeup: int | None = None  #: when a stage may start its prepare
        self.shut = -1  #: the state of the scheduler in which it was too early for every stage
        self.usage: dict[str, Usage] = {}  #: by stage
        self._infer_since = 0
        self._history: dict[str, deque[int]] = {}
        self._medians: dict[str, int] = {}
        self._longest: dict[str, deque[int]] = {}
        self._check_every = check_every
        self._pause = check_every
        self._up_since: int | None = None  #: when it last came back

    def begin(self, run: ActiveRun, timeout: int | None, now: int) -> None:
        """The device starts to infer."""
        self.inferring = run
        self._infer_since = now
        self.overdue_at = now + (self._timeout(run.stage) if timeout is None else timeout)
        usage = self.usage.setdefault(run.stage, Usage())
        usage.waits_ns.append(now - run.prepared_at)

    def end(self, run: ActiveRun, now: int, *, failed: bool) -> None:
        """The infer is over: its time feeds the prediction, unless it failed."""
        took = now - self._infer_since
        self.inferring = self.overdue_at = None
        usage = self.usage[run.stage]
        usage.busy_ns += took
        usage.runs += 1
        if failed:
            return
        history = self._history.setdefault(run.stage, deque(maxlen=HISTORY))
        history.append(took)
        self._medians[run.stage] = median_high(history)
        self._longest.setdefault(run.stage, deque(maxlen=LONGEST_OF)).append(took)

    def _timeout(self, stage: str) -> int:
        longest = self._longest.get(stage)
        if not longest:
            return OVERDUE_FIRST_NS
        return max(OVERDUE_FACTOR * max(longest), OVERDUE_FLOOR_NS)

    def usual_ns(self, stage: str) -> int:
        """What an infer of a stage takes: the upper median of the last; 0 without one."""
        return self._medians.get(stage, 0)

    # ------------------------------------------------------------------ up and down

    def lose(self, now: int) -> None:
        """The device is gone; it is checked after a pause, longer where it does not stay."""
        self.up = self.checking = False
        steady = self._up_since is None or now - self._up_since >= STEADY_PAUSES * self._pause
        longest = LONGEST_PAUSE * self._check_every
        self._pause = self._check_every if steady else min(2 * self._pause, longest)
        self.check_due = now + self._pause
        self.inferring = self.overdue_at = self.wakeup = None
        for stage in self.stages:
            stage.stand()

    def check(self) -> None:
        """A check is under way."""
        self.checking, self.check_due = True, None

    def still_lost(self, now: int) -> None:
        """The check said no."""
        self.checking, self.check_due = False, now + self._pause

    def restore(self, now: int) -> None:
        """The device is back."""
        self.up, self.checking, self.check_due = True, False, None
        self._up_since = now
        for stage in self.stages:
            stage.stand()

    def due(self) -> int:
        """The least instant at which time alone changes something about it."""
        due = INFINITY if self.wakeup is None else self.wakeup
        if self.overdue_at is not None and self.overdue_at < due:
            due = self.overdue_at
        return due if self.check_due is None else min(due, self.check_due)

    # ------------------------------------------------------------------ prediction

    def free_at(self, now: int) -> int:
        """When the running infer is predicted to be over; `now` if none runs or it is overdue."""
        if self.inferring is None:
            return now
        return max(now, self._infer_since + self._medians.get(self.inferring.stage, 0))
