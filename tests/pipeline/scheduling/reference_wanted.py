"""Wanted frames by definition: section 10 of pipeline/scheduling/README.md, every wish tried
against every instant."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import inf
from statistics import median_high
from typing import NamedTuple

from reference_devices import Devices
from reference_streams import Edge, Item

from pipeline.scheduling.events import Reason
from pipeline.scheduling.topology import Missing, Port, Role, StageNode, Sync

MISSED = Reason.REPLACED, Reason.TOO_OLD, Reason.DECIMATED


class Wish(NamedTuple):
    kind: str  #: "must"; "all": every frame is a must; "may": any frame will do
    root: Port | None = None
    edge: Edge | None = None  #: to the input that chooses


@dataclass
class Rhythm:
    """What the stamps of a stream say of the next ones."""

    stamps: list[int]

    @property
    def gaps(self) -> list[int]:
        return [later - earlier for earlier, later in pairwise(self.stamps)][-8:]

    @property
    def period(self) -> int:
        return median_high(self.gaps) if self.gaps else 0

    @property
    def regular(self) -> bool:
        even = [gap for gap in self.gaps if 4 * abs(gap - self.period) <= self.period]
        return len(self.gaps) >= 4 and 2 * len(even) > len(self.gaps)

    def reaches(self, m: int) -> bool:
        return self.regular and m <= self.stamps[-1] + 3 * self.period

    def instants(self, until: int) -> list[int]:
        return self.stamps[-8:] + list(range(self.stamps[-1] + self.period, until + 1, self.period))


class Wanted(Devices):
    # Wishes

    def _root(self, node: StageNode) -> Port:
        source = self._trigger(node).source
        above = self.node[source.stage]
        return source if above.is_source else self._root(above)

    def _wishes(self, node: StageNode) -> Iterator[Wish]:
        members = [edge.node.name for edge in self._group(self._trigger(node))]
        for edge in self.edges:
            if edge.source.stage not in members:
                continue
            sync, other = edge.input.sync, self._root(edge.node) != self._root(node)
            if sync is Sync.SPAN:
                yield Wish("all")
            elif sync is Sync.TRIGGER and edge.node.wanted:
                yield from self._wishes(edge.node)
            elif sync is not Sync.TRIGGER and other:
                yield Wish("must", self._root(edge.node), edge)
            else:
                yield Wish("may")

    # Predictions

    def _rhythm(self, node: StageNode) -> Rhythm:
        return Rhythm([item.s for item in self._trigger(node).items if item.kept])

    def _reaches(self, wish: Wish, m: int) -> bool:
        return wish.root is None or Rhythm(self.outlets[wish.root].stamps).reaches(m)

    def _meets(self, wish: Wish, f: int, gap: int, p: int) -> bool:
        """Whether the frame `f` is a must by this wish alone."""
        if wish.root is None or wish.edge is None:
            return wish.kind == "all"
        rule = wish.edge.input
        e, tolerance = f + rule.offset, rule.tolerance
        instants = Rhythm(self.outlets[wish.root].stamps).instants(e + p + tolerance)
        if rule.sync is Sync.EXACT:
            met = [T for T in instants if e == T]
        elif rule.sync is Sync.LATEST:
            met = [T for T in instants if e <= T < e + p]
        else:
            met = [T for T in instants if abs(e - T) <= tolerance and -gap < 2 * (T - e) <= p]
        slots = [edge for edge in self.edges if edge.node is wish.edge.node]
        return any(not any(self._nothing_in_reach(slot, T) for slot in slots) for T in met)

    def _nothing_in_reach(self, slot: Edge, T: int) -> bool:
        """Whether the slot makes the instant void."""
        rule, above = slot.input, self.node[slot.source.stage]
        if rule.sync is not Sync.NEAREST or rule.missing is not Missing.SKIP:
            return False
        port = slot.source if above.is_source else self._root(above)
        own = Rhythm([stamp + rule.offset for stamp in self.outlets[port].stamps])
        if self.node[port.stage].role is Role.REMOTE or not own.reaches(T):
            return False
        reach = rule.tolerance + 2 * max(abs(gap - own.period) for gap in own.gaps)
        near = [s for s in own.instants(T + reach) if abs(s - T) <= reach]
        return own.stamps[-8:][0] <= T and not near

    def _judge(self, node: StageNode, item: Item) -> str:
        own, wishes = self._rhythm(node), list(self._wishes(node))
        if not own.regular or not all(self._reaches(wish, item.s) for wish in wishes):
            return "every"
        before = Rhythm(own.stamps[:-1])
        gap = 2 * (item.s - before.stamps[-1]) - before.period
        if any(self._meets(wish, item.s, gap, own.period) for wish in wishes):
            return "must"
        return "may" if Wish("may") in wishes else "no"

    # Queues

    def _enqueue(self, edge: Edge, item: Item) -> None:
        if edge.node.wanted:
            item.verdict = self._judge(edge.node, item)
            ahead = [older.verdict for older in edge.held("queue", "undecided")]
            better = not self.offline and ("every" in ahead or "must" in ahead)
            if item.verdict == "no" or (item.verdict == "may" and better):
                self._drop(edge, item, Reason.NOT_WANTED)
                return
        super()._enqueue(edge, item)

    def _drop(self, edge: Edge, item: Item, reason: Reason) -> None:
        super()._drop(edge, item, reason)
        if item.verdict == "must" and reason in MISSED:
            self.observer.event("wish_missed", edge.node.name, "", self.now)

    # Turns

    def _head(self, node: StageNode) -> Item | None:
        head = super()._head(node)
        asked = head is not None and head.verdict == "may" and head.place != "decided"
        if head is None or not asked or self.offline:
            return head
        members = [edge.node for edge in self._members(self._trigger(node))]
        for device in {self._device(member) for member in members if member.devices}:
            assert device is not None  # members are live
            sharing = [member for member in members if self._device(member) == device]
            done = self._free_at(device) + sum(self._usual(m.name, device) for m in sharing)
            if done > self._next_must(device, head.s):
                return None
        return head

    def _next_must(self, device: str, m: int) -> float:
        """When the next frame that must be run on the device is predicted to arrive."""
        due = inf
        for node in self.nodes:
            if not node.wanted or not self._live(node) or self._device(node) != device:
                continue
            own, ended = self._rhythm(node), self._bound(self._trigger(node).source) == inf
            if ended or not own.reaches(m):
                continue
            f, p = own.stamps[-1], own.period
            a = next(i.arrived for i in self._trigger(node).items if i.kept and i.s == f)
            for wish in [wish for wish in self._wishes(node) if self._reaches(wish, m)]:
                ahead = [n for n in range(1, 17) if self._meets(wish, f + n * p, p, p)]
                if ahead:
                    due = min(due, a + ahead[0] * p)
        return due
