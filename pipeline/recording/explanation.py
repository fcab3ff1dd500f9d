"""Why a stage ran when it did, on what, and why it did not: told from the recorded events.

There is no second truth: the scheduler itself is stepped through the recording, and what it holds
and judges is written down. The streams' later messages, which it could not know, tell what it
missed.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import chain
from typing import Any

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording.flight import Event, Flight
from pipeline.recording.reenactment import Reenactment
from pipeline.scheduling.bounds import INFINITY
from pipeline.scheduling.events import InputSet, Mark, Observer, Reason
from pipeline.scheduling.sync import FIRST_WAIT_NS, Slot, SpanSlot
from pipeline.scheduling.topology import Input, Port, StageNode, Sync

FIRED, OPEN = "fired", "open"


class Verdict(StrEnum):
    """What became of one input in one set."""

    SETTLED = "settled"  #: chosen, and proven to be the best
    UNPROVEN = "unproven"  #: chosen when the wait was over; a better one could still come
    HELD = "held"  #: the last one, kept over
    NOTHING = "nothing"  #: proven: no message will do
    LATE = "late"  #: none when the wait was over; one that would have done came later
    SILENT = "silent"  #: none when the wait was over, and none later
    OPEN = "open"  #: the trigger formed no set


@dataclass(frozen=True, slots=True)
class InputStory:
    """One edge of an input, seen from one trigger. Times in ms; gaps are signed: + is later."""

    input: str
    edge: int  #: its number in the input
    source: str
    sync: str
    tolerance_ms: float | None
    verdict: str
    used: tuple[float, ...]  #: gaps of the messages in the set: (first, last) of a span
    nearest_ms: float | None  #: gap of the nearest message that ever came
    nearest_came_ms: float | None  #: when that came, after the trigger's arrival
    why: str


@dataclass(frozen=True, slots=True)
class TriggerStory:
    """One trigger of a stage, from its arrival to its end."""

    seq: int
    at_s: float  #: its stamp, from the beginning of the flight
    stamp: int  #: ns, on the graph's clock
    arrived_s: float
    decided_s: float | None  #: when it was started or dropped; None: it still waited at the end
    outcome: str  #: "fired", a reason of the ledger, or "open"
    run: int | None
    waited_ms: float
    waits: Mapping[str, float]  #: ms by what it waited for: a cause, or an edge
    inputs: tuple[InputStory, ...]


@dataclass(slots=True)
class Candidates:
    """All messages of one sync edge; stamps with the offset added."""

    rule: Input
    number: int
    port: Port
    stamps: list[int] = field(default_factory=list)
    arrivals: list[int] = field(default_factory=list)

    def nearest(self, stamp: int) -> int | None:
        """The index of the message nearest to a stamp, ties to the earlier."""
        after = bisect_left(self.stamps, stamp)
        around = [n for n in (after - 1, after) if 0 <= n < len(self.stamps)]
        return min(around, key=lambda n: abs(self.stamps[n] - stamp), default=None)

    def gap(self, stamp: int) -> int:
        """From a stamp to the message nearest to it, ns; there must be one."""
        place = self.nearest(stamp)
        assert place is not None
        return self.stamps[place] - stamp


@dataclass(slots=True)
class _Judged:
    """A slot as it was when a set was taken from it."""

    mark: Mark | None
    used: tuple[int, ...]
    bound: int
    why_over: str  #: why the wait ended without proof; empty where it did not


@dataclass(slots=True)
class _Told:
    """A trigger on its way."""

    message: Message[Any]
    arrived: int
    exact_wait: int
    decided: int | None = None
    outcome: str = OPEN
    run: int | None = None
    waits: Counter[str] = field(default_factory=Counter)
    judged: tuple[_Judged, ...] = ()


@dataclass(frozen=True, slots=True)
class Explanation:
    """Every trigger of one stage."""

    node: StageNode
    begin: int  #: ns, of the flight
    triggers: tuple[TriggerStory, ...]
    candidates: tuple[Candidates, ...]  #: by sync edge
    streams: Mapping[str, tuple[list[int], list[int]]]  #: stamps and arrivals of each source
    gap: str | None = None  #: what is missing after the last trigger that is explained


def explain(flight: Flight, stage: str) -> Explanation:
    """Step through a flight and tell of one stage. Raises DataError."""
    nodes = {node.name: node for node in flight.manifest.topology.stages if not node.is_source}
    node = nodes.get(stage)
    if node is None:
        raise DataError(f"{flight.path}: no stage '{stage}' with inputs; there are {[*nodes]}")
    watch = _Watch(node)
    manifest = flight.manifest
    reenactment = Reenactment(manifest.topology, offline=manifest.offline, observer=watch)
    watch.scheduler = reenactment.scheduler
    last: Event | None = None
    begin, gap = 0, None
    for event in chain.from_iterable(page.events for page in flight.pages()):
        if (gap := flight.gap(last, event)) is not None:
            break
        begin = event.now if last is None else begin
        watch.passed(event.now)
        reenactment.step(event)
        watch.look(event.now)
        last = event
    sources = {port.stage for port in watch.streams} & {
        one.name for one in manifest.topology.stages if one.is_source
    }
    return Explanation(
        node,
        begin,
        tuple(watch.story(told, begin) for told in watch.told.values()),
        tuple(watch.candidates),
        {str(port): times for port, times in watch.streams.items() if port.stage in sources},
        gap,
    )


class _Watch(Observer):
    """Follows the triggers of one stage."""

    def __init__(self, node: StageNode) -> None:
        self._node = node
        self._trigger = node.trigger
        self.scheduler: Any = None
        self.told: dict[int, _Told] = {}  #: by number of the trigger
        self.streams: dict[Port, tuple[list[int], list[int]]] = {}
        self.candidates = [
            Candidates(rule, number, port)
            for rule in node.inputs
            if rule.sync is not Sync.TRIGGER
            for number, port in enumerate(rule.sources)
        ]
        self._waiting: list[tuple[int, str]] = []  #: triggers and what they wait for, since
        self._since = 0
        self._last_stamp: int | None = None
        self._run = 0

    # ------------------------------------------------------------------ what the scheduler says

    def published(self, port: Port, message: Message[Any], now: int) -> None:
        stamps, arrivals = self.streams.setdefault(port, ([], []))
        stamps.append(message.stamp)
        arrivals.append(now)
        for candidates in self.candidates:
            if candidates.port == port:
                candidates.stamps.append(message.stamp + candidates.rule.offset)
                candidates.arrivals.append(now)
        if port == self._trigger.sources[0]:
            last, self._last_stamp = self._last_stamp, message.stamp
            wait = FIRST_WAIT_NS if last is None else 2 * (message.stamp - last)
            self.told[message.seq] = _Told(message, now, wait)

    def dropped(
        self, source: Port, stage: str, name: str, message: Message[Any], reason: Reason, now: int
    ) -> None:
        if stage == self._node.name and name == self._trigger.name:
            told = self.told[message.seq]
            self._decide(told, reason, now)
            if reason is Reason.SET_SKIPPED:
                told.judged = self._judge(told, None, now)

    def set_formed(self, stage: str, inputs: InputSet, now: int) -> None:
        if stage == self._node.name:
            told = self.told[inputs.trigger.seq]
            self._decide(told, FIRED, now)
            told.run, self._run = self._run, self._run + 1
            told.judged = self._judge(told, inputs, now)

    def _decide(self, told: _Told, outcome: str, now: int) -> None:
        told.decided, told.outcome = now, str(outcome)

    def _judge(self, told: _Told, inputs: InputSet | None, now: int) -> tuple[_Judged, ...]:
        """What the slots say of the set that was just taken from them."""
        judged: list[_Judged] = []
        for edge, slot in self.scheduler.slots(self._node.name):
            used: tuple[int, ...] = ()
            if slot.choice >= 0 and inputs is not None:
                span = slot.range if isinstance(slot, SpanSlot) else (slot.choice, slot.choice + 1)
                chosen = slot.stamps[slice(*span)]
                used = (chosen[0], chosen[-1]) if isinstance(slot, SpanSlot) else (chosen[0],)
            over = "" if slot.mark is None or _proven(slot, told) else self._over(slot, told, now)
            judged.append(_Judged(slot.mark, used, slot.bound, over))
            assert edge.slot is slot
        return tuple(judged)

    def _over(self, slot: Slot, told: _Told, now: int) -> str:
        wait = told.exact_wait if slot.max_wait is None else slot.max_wait
        if now >= told.arrived + wait:
            return f"its wait of {wait / 1e6:g} ms was over"
        if slot.stale:
            return "the stream was stale, so nobody waited for it"
        return "four sets waited and a fifth trigger came"

    # ------------------------------------------------------------------ time between the events

    def passed(self, now: int) -> None:
        """The time since the last event was spent on what the triggers waited for then."""
        for seq, cause in self._waiting:
            self.told[seq].waits[cause] += now - self._since

    def look(self, now: int) -> None:
        """What every trigger waits for from now on."""
        waits = self.scheduler.waits(self._node.name)
        self._waiting = [(wait.message.seq, wait.edge or str(wait.cause)) for wait in waits]
        self._since = now

    # ------------------------------------------------------------------ the stories

    def story(self, told: _Told, begin: int) -> TriggerStory:
        decided = told.decided
        judged = told.judged or (None,) * len(self.candidates)
        return TriggerStory(
            seq=told.message.seq,
            at_s=(told.message.stamp - begin) / 1e9,
            stamp=told.message.stamp,
            arrived_s=(told.arrived - begin) / 1e9,
            decided_s=None if decided is None else (decided - begin) / 1e9,
            outcome=told.outcome,
            run=told.run,
            waited_ms=0.0 if decided is None else (decided - told.arrived) / 1e6,
            waits={cause: ns / 1e6 for cause, ns in told.waits.items() if ns > 0},
            inputs=tuple(
                _input_story(told, candidates, one)
                for candidates, one in zip(self.candidates, judged, strict=True)
            ),
        )


def _proven(slot: Slot, told: _Told) -> bool:
    """Whether a slot without a settled message was settled without one."""
    stamp, sync = told.message.stamp, slot.rule.sync
    if sync is Sync.NEAREST:
        return slot.bound > stamp + slot.tolerance
    if sync is Sync.EXACT:
        return slot.bound > stamp
    return sync is Sync.LATEST or slot.bound >= INFINITY


def _input_story(told: _Told, candidates: Candidates, judged: _Judged | None) -> InputStory:
    rule, stamp = candidates.rule, told.message.stamp
    place = candidates.nearest(stamp)
    gap = came = None
    if place is not None:
        gap = (candidates.stamps[place] - stamp) / 1e6
        came = (candidates.arrivals[place] - told.arrived) / 1e6
    used = () if judged is None else tuple((one - stamp) / 1e6 for one in judged.used)
    verdict = _verdict(candidates, place, told, judged)
    return InputStory(
        input=rule.name,
        edge=candidates.number,
        source=str(candidates.port),
        sync=str(rule.sync),
        tolerance_ms=rule.tolerance / 1e6 if rule.sync is Sync.NEAREST else None,
        verdict=str(verdict),
        used=used,
        nearest_ms=gap,
        nearest_came_ms=came,
        why=_why(rule, verdict, used, gap, came, judged, told),
    )


def _verdict(
    candidates: Candidates, place: int | None, told: _Told, judged: _Judged | None
) -> Verdict:
    if judged is None:
        return Verdict.OPEN
    if judged.mark is None:
        return Verdict.SETTLED
    if judged.mark is not Mark.MISSING:
        return Verdict.UNPROVEN if judged.mark is Mark.UNSETTLED else Verdict.HELD
    if not judged.why_over:
        return Verdict.NOTHING
    if place is not None and told.decided is not None:
        rule = candidates.rule
        off = abs(candidates.stamps[place] - told.message.stamp)
        fits = off <= (rule.tolerance if rule.sync is Sync.NEAREST else 0)
        if fits and candidates.arrivals[place] > told.decided:
            return Verdict.LATE
    return Verdict.SILENT


def _why(
    rule: Input,
    verdict: Verdict,
    used: tuple[float, ...],
    gap: float | None,
    came: float | None,
    judged: _Judged | None,
    told: _Told,
) -> str:
    over = "" if judged is None else judged.why_over
    decided = 0.0 if told.decided is None else (told.decided - told.arrived) / 1e6
    nearest = "nothing ever came" if gap is None else f"the nearest that ever came is {gap:+.1f} ms"
    if verdict is Verdict.OPEN:
        return nearest
    if verdict is Verdict.SETTLED:
        if rule.sync is Sync.SPAN:
            return f"from {used[0]:+.1f} to {used[-1]:+.1f} ms"
        return "its very stamp" if rule.sync is Sync.EXACT else f"{used[0]:+.1f} ms"
    if verdict is Verdict.NOTHING:
        if rule.sync is Sync.NEAREST:
            return f"within {rule.tolerance / 1e6:g} ms; {nearest}"
        return f"of its stamp; {nearest}" if rule.sync is Sync.EXACT else nearest
    if verdict is Verdict.LATE:
        assert came is not None
        return f"{gap:+.1f} ms came {came - decided:.1f} ms after {over}"
    if verdict is Verdict.SILENT:
        return f"when {over}; {nearest}"
    taken = f"{used[0]:+.1f} ms" if used else "nothing"
    if verdict is Verdict.HELD:
        return f"{taken} kept over, {'nothing nearer will come' if not over else f'when {over}'}"
    better = used and gap is not None and abs(gap) < abs(used[0])
    later = f"; {gap:+.1f} ms came {(came or 0) - decided:.1f} ms later" if better else ""
    return f"{taken} taken when {over}{later}"
