"""Time-synchronised input sets of one stage: which messages belong to a trigger, and when.

Written against sections 5 and 6 of README.md in this folder. Everything here is a pure state
machine over integers; stamps are effective ones (stamp + offset).
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from pipeline.message import MAX_EXTENT_NS, Message
from pipeline.scheduling.bounds import INFINITY, NEVER
from pipeline.scheduling.events import InputSet, Mark, Reason, Value
from pipeline.scheduling.topology import Input, Missing, Sync
from pipeline.scheduling.wanted import Verdict

#: Sets that may wait; one more forces the oldest. Four cover a lag of four trigger periods.
MAX_WAITING = 4
#: What an exact input waits for where no trigger period is known yet.
FIRST_WAIT_NS = 200_000_000
CAP = 64
SPAN_CAP = 4096

#: Told of every message that a slot lets go unused.
OnDrop = Callable[["Slot", Message[Any], Reason], None]


class WaitingSet:
    """A trigger that waits for its set."""

    __slots__ = ("arrived", "exact_wait", "forced", "gap", "message", "stamp", "verdict")

    def __init__(self, message: Message[Any], arrived: int, gap: int = 0) -> None:
        self.message = message
        self.stamp = message.stamp
        self.arrived = arrived
        self.gap = gap  #: to the trigger that arrived before; 0 without one
        self.exact_wait = 2 * gap or FIRST_WAIT_NS
        self.forced = False
        self.verdict = Verdict.EVERY


class Slot:
    """The messages of one sync edge, by stamp. Subclasses say what settles and what is useless."""

    cap = CAP
    is_span = False

    def __init__(self, rule: Input, on_drop: OnDrop, *, offline: bool = False) -> None:
        self.rule = rule
        self.offline = offline
        self.offset = rule.offset
        self.tolerance = rule.tolerance
        self.max_wait = rule.max_wait
        self.holds = rule.missing is Missing.HOLD and rule.sync is not Sync.LATEST
        self.bound = NEVER
        self.stale = False
        self.stamps: list[int] = []
        self.messages: list[Message[Any]] = []
        self.used: list[bool] = []
        self.choice = -1  #: index of the candidate for the set that was judged last
        self.mark: Mark | None = None  #: what that set says of it
        self._on_drop = on_drop

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def unused(self) -> int:
        """Messages held and not yet used by a started run."""
        return self.used.count(False)

    def deadline(self, waiting: WaitingSet) -> int:
        wait = self.max_wait
        return waiting.arrived + (waiting.exact_wait if wait is None else wait)

    def settled(self, stamp: int) -> bool:
        """Judge the set at `stamp`: fills `choice` with the best candidate (or -1)."""
        raise NotImplementedError

    def useless(self, least: int) -> int:
        """How many of the first messages no set at or above `least` can take."""
        raise NotImplementedError

    def floor(self, least: int) -> int:
        """The least stamp that a set at or above `least` may take from here."""
        raise NotImplementedError

    def add(self, message: Message[Any]) -> None:
        self.stamps.append(message.stamp + self.offset)
        self.messages.append(message)
        self.used.append(False)
        if len(self.stamps) > self.cap and not self.offline:
            self.release(1, Reason.QUEUE_FULL)

    def prune(self, least: int) -> None:
        count = len(self.stamps) if least >= INFINITY else self.useless(least)
        if self.holds and count and least < INFINITY:
            count = min(count, max(bisect_right(self.stamps, least) - 1, 0))
        if count:
            self.release(count, Reason.PASSED_OVER)

    def release(self, count: int, reason: Reason) -> None:
        """Let the first messages go; those that were never used are dropped."""
        for message, used in zip(self.messages[:count], self.used[:count], strict=True):
            if not used:
                self._on_drop(self, message, reason)
        del self.stamps[:count], self.messages[:count], self.used[:count]


class ExactSlot(Slot):
    """The message with the trigger's very stamp."""

    def settled(self, stamp: int) -> bool:
        index = bisect_left(self.stamps, stamp)
        if index < len(self.stamps) and self.stamps[index] == stamp:
            self.choice = index
            return True
        self.choice = -1
        return self.bound > stamp

    def useless(self, least: int) -> int:
        return bisect_left(self.stamps, least)

    def floor(self, least: int) -> int:
        return least - self.rule.hold if self.holds else least


class NearestSlot(Slot):
    """The message nearest to the trigger within the tolerance; ties go to the earlier."""

    def settled(self, stamp: int) -> bool:
        stamps, tolerance = self.stamps, self.tolerance
        after = bisect_left(stamps, stamp)
        choice, gap = -1, tolerance + 1
        if after and stamp - stamps[after - 1] <= tolerance:
            choice, gap = after - 1, stamp - stamps[after - 1]
        if after < len(stamps) and stamps[after] - stamp < gap:
            choice, gap = after, stamps[after] - stamp
        self.choice = choice
        return self.bound >= stamp + gap

    def useless(self, least: int) -> int:
        stamps = self.stamps
        count = bisect_left(stamps, least - self.tolerance)
        last = len(stamps) - 1
        while count < last and least - stamps[count] > stamps[count + 1] - least:
            count += 1
        return count

    def floor(self, least: int) -> int:
        floor = least - self.tolerance
        return min(floor, least - self.rule.hold) if self.holds else floor


class LatestSlot(Slot):
    """The newest message not after the trigger; waits only offline, where bounds decide."""

    def settled(self, stamp: int) -> bool:
        self.choice = bisect_right(self.stamps, stamp) - 1
        return not self.offline or self.bound > stamp

    def useless(self, least: int) -> int:
        return max(bisect_right(self.stamps, least) - 1, 0)

    def floor(self, least: int) -> int:
        floor = self.stamps[0] if self.stamps else self.bound
        return min(floor, least - self.rule.hold) if self.rule.missing is Missing.HOLD else floor


class SpanSlot(Slot):
    """Every message around the set; judged last, over the extent of everything chosen."""

    cap = SPAN_CAP
    is_span = True

    def __init__(self, rule: Input, on_drop: OnDrop, *, offline: bool = False) -> None:
        super().__init__(rule, on_drop, offline=offline)
        self.extent = (0, 0)  #: least begin and greatest end of the set that is judged
        self.range = (0, 0)  #: indices of the chosen messages, end exclusive

    def settled(self, stamp: int) -> bool:
        low, high = self.extent
        stamps = self.stamps
        first = max(bisect_right(stamps, low) - 1, 0)
        after = bisect_left(stamps, high)
        self.range = (first, min(after + 1, len(stamps)))
        self.choice = first if self.range[0] < self.range[1] else -1
        return after < len(stamps) or self.bound >= INFINITY

    def useless(self, least: int) -> int:
        return max(bisect_right(self.stamps, least) - 1, 0)  # `least` is the floor of the others

    def floor(self, least: int) -> int:
        return least


_SLOTS: dict[Sync, type[Slot]] = {
    Sync.EXACT: ExactSlot,
    Sync.NEAREST: NearestSlot,
    Sync.LATEST: LatestSlot,
    Sync.SPAN: SpanSlot,
}


class Synchronizer:
    """Forms the input sets of one stage.

    `offer` and `bound` bring what the other streams say, `open` a trigger; `ready` tells whether
    the oldest set can fire and `take` makes it. The owner calls `lower` as the least stamp of
    future sets rises.
    """

    def __init__(
        self, inputs: Sequence[Input], on_drop: OnDrop | None = None, *, offline: bool = False
    ) -> None:
        drop = on_drop or (lambda slot, message, reason: None)
        self.slots: list[Slot] = []
        self._layout: list[tuple[Input, int, int]] = []  #: input, first slot, end of its slots
        for rule in inputs:
            first = len(self.slots)
            if rule.sync is not Sync.TRIGGER:
                self.slots += [_SLOTS[rule.sync](rule, drop, offline=offline) for _ in rule.sources]
            self._layout.append((rule, first, len(self.slots)))
        self._plain = [slot for slot in self.slots if not isinstance(slot, SpanSlot)]
        self._spans = [slot for slot in self.slots if isinstance(slot, SpanSlot)]
        self._offline = offline
        self.waiting: deque[WaitingSet] = deque()
        self.least = NEVER
        self._span_floor = NEVER  #: no set takes a span's message before the last at or below it
        self._triggers: deque[WaitingSet] = (
            deque()
        )  #: recent ones, to see who is late (stale slots)
        self.skips = False  #: the set judged last misses a required input
        self._timed_out: list[Slot] = []  #: slots whose wait for that set is over
        self._blocker: Slot | None = None  #: what the oldest set waits for; None: not judged yet

    # ------------------------------------------------------------------ what comes in

    def offer(self, slot: Slot, message: Message[Any], now: int) -> bool:
        """A message on a sync edge; True when the oldest set may have become ready."""
        slot.add(message)
        stamp = message.stamp + slot.offset
        if stamp >= slot.bound:
            slot.bound = stamp + 1
        if slot.stale and self._in_time(slot, stamp, now):
            slot.stale = False
        if slot.is_span:
            slot.prune(self._span_floor)
        else:
            slot.prune(self.least)
            if self._spans and slot.rule.sync is Sync.LATEST:
                self._prune_spans()
        return self._may_settle(slot)

    def bound(self, slot: Slot, bound: int) -> bool:
        """The bound of a slot's stream (effective) rose; True as in `offer`."""
        if bound <= slot.bound:
            return False
        slot.bound = bound
        if self._spans and slot.rule.sync is Sync.LATEST and not slot.stamps:
            self._prune_spans()
        return self._may_settle(slot)

    def open(self, waiting: WaitingSet) -> None:
        """A trigger starts to wait."""
        self.waiting.append(waiting)
        if len(self.waiting) == 1:
            self._blocker = None

    def arrived(self, waiting: WaitingSet) -> None:
        """A trigger arrived at the stage (it may still be queued): noted for stale slots."""
        triggers = self._triggers
        triggers.append(waiting)
        while len(triggers) > 1 and all(
            slot.deadline(triggers[1]) <= waiting.arrived for slot in self.slots
        ):
            triggers.popleft()

    def lower(self, least: int) -> None:
        """No set below `least` will be asked for any more: let useless messages go."""
        if least <= self.least:
            return
        self.least = least
        for slot in self._plain:
            slot.prune(least)
        if self._spans:
            self._prune_spans()

    # ------------------------------------------------------------------ what goes out

    def ready(self, now: int) -> bool:
        """Whether the oldest set can fire now; judges every slot for it."""
        if not self.waiting:
            return False
        self._blocker = None
        self._timed_out.clear()
        self.skips = False
        head = self.waiting[0]
        for slot in self._plain:
            if not self._judge(slot, head, now):
                return False
        for span in self._spans:
            span.extent = self._extent(head)
            if not self._judge(span, head, now):
                return False
        return True

    @property
    def blocker(self) -> Slot | None:
        """What the oldest set waits for, as it was judged last."""
        return self._blocker if self.waiting else None

    def next_deadline(self) -> int:
        """When the slot that the oldest set waits for times out; INFINITY: no such instant."""
        if self._blocker is None or self._offline or not self.waiting:
            return INFINITY
        return self._blocker.deadline(self.waiting[0])

    def take(self) -> tuple[InputSet, list[Slot]]:
        """Fire the oldest set as `ready` judged it just now; also the slots that go stale over it.

        Where `skips` is set, a required input is missing and the set must not be used.
        """
        head = self.waiting.popleft()
        self._blocker = None
        for slot in self._timed_out:
            slot.stale = True
        values: list[Any] = []
        marks: list[tuple[str, int, Mark]] = []
        for rule, first, end in self._layout:
            if rule.sync is Sync.TRIGGER:
                values.append(head.message)
                continue
            slots = self.slots[first:end]
            for number, slot in enumerate(slots):
                if slot.mark is not None:
                    marks.append((rule.name, number, slot.mark))
            several = tuple(_value(slot) for slot in slots)
            values.append(several if rule.many else several[0])
        return InputSet(head.message, tuple(values), tuple(marks)), list(self._timed_out)

    def chosen(self, slot: Slot) -> range:
        """Indices of the messages that the set just taken uses from a slot."""
        if slot.choice < 0:
            return range(0)
        if isinstance(slot, SpanSlot):
            return range(*slot.range)
        return range(slot.choice, slot.choice + 1)

    # ------------------------------------------------------------------ inside

    def _judge(self, slot: Slot, head: WaitingSet, now: int) -> bool:
        """Whether a slot lets the set fire; notes its choice, its mark and if it timed out."""
        stamp = head.stamp
        settled = slot.settled(stamp)
        if not settled:
            expired = not self._offline and now >= slot.deadline(head)
            if self._offline or not (head.forced or slot.stale or expired):
                self._blocker = slot
                return False
            if expired and not slot.stale:
                self._timed_out.append(slot)
        slot.mark = None if settled else Mark.UNSETTLED
        if slot.choice < 0:
            slot.mark = Mark.MISSING
            if slot.holds:
                held = bisect_right(slot.stamps, stamp) - 1
                if held >= 0 and stamp - slot.stamps[held] <= slot.rule.hold:
                    slot.choice, slot.mark = held, Mark.HELD
            if slot.choice < 0 and slot.rule.missing is Missing.SKIP:
                self.skips = True
        return True

    def _may_settle(self, slot: Slot) -> bool:
        if not self.waiting:
            return False
        if self._blocker is None:
            return True
        # Nothing settles a slot before its stream has reached the trigger (README, section 5).
        return slot is self._blocker and slot.bound >= self.waiting[0].stamp

    def _in_time(self, slot: Slot, stamp: int, now: int) -> bool:
        """Whether a message on a stale slot is newer than every trigger that waited it out."""
        for trigger in reversed(self._triggers):
            if slot.deadline(trigger) <= now:
                return stamp > trigger.stamp
        return True

    def _extent(self, head: WaitingSet) -> tuple[int, int]:
        """Least begin and greatest end over the trigger and what was chosen of the other slots."""
        low, high = head.message.begin, head.message.end
        for slot in self._plain:
            if slot.choice >= 0:
                message = slot.messages[slot.choice]
                low = min(low, message.begin + slot.offset)
                high = max(high, message.end + slot.offset)
        return low, high

    def _prune_spans(self) -> None:
        floor = self.least
        if floor < INFINITY:
            floor = min([floor, *(slot.floor(floor) for slot in self._plain)]) - MAX_EXTENT_NS
        self._span_floor = floor
        for span in self._spans:
            span.prune(floor)


def _value(slot: Slot) -> Value:
    if slot.choice < 0:
        return None
    if isinstance(slot, SpanSlot):
        return tuple(slot.messages[slice(*slot.range)])
    return slot.messages[slot.choice]
