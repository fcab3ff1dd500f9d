"""What happens to messages: ports, bounds, edges, trigger queues, select groups and sync slots.

Sections 1 to 5 of README.md in this folder; `Runs` and `Scheduler` build on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from heapq import heappush
from typing import Any

from pipeline.message import Message
from pipeline.scheduling.bounds import INFINITY, NEVER, OutputPort
from pipeline.scheduling.edges import Edge
from pipeline.scheduling.events import Bound, Notice, Observer, Reason, Took
from pipeline.scheduling.stages import StageState
from pipeline.scheduling.sync import MAX_WAITING, Slot, Synchronizer, WaitingSet
from pipeline.scheduling.topology import Policy, Role, Topology
from pipeline.scheduling.wanted import Verdict
from pipeline.scheduling.wiring import wire


class Streams:
    """The messages of one graph: where each is held, and how each ends."""

    def __init__(self, topology: Topology, *, offline: bool, observer: Observer | None) -> None:
        self._offline = offline
        self._observer = observer or Observer()
        self._now = 0
        self._stopping = False
        self._dirty: list[int] = []  #: stages to look at before the event is over: a heap
        wiring = wire(topology, self._drop, offline=offline)
        self._stages = wiring.stages
        self._by_name = {stage.node.name: stage for stage in self._stages}
        self._ports = wiring.ports
        self._devices = wiring.devices
        self._wanted = [stage for stage in self._stages if stage.wishes is not None]
        self._senders = [stage for stage in self._stages if stage.node.role is Role.SENDER]
        self._said: dict[str, int] = {}  #: by sender: the bound that was told
        self._took: list[Notice] = []

    def _event(self, kind: str, subject: str, text: str) -> None:
        """Tell of something that people should know."""
        self._observer.event(kind, subject, text, self._now)

    # ------------------------------------------------------------------ messages

    def _send(self, output: OutputPort, message: Message[Any]) -> None:
        """Enter a message that the port takes into the books of all its edges."""
        output.last = message.stamp
        output.published += 1
        self._observer.published(output.port, message, self._now)
        if output.rhythm is not None:
            output.rhythm.add(message.stamp, self._now)
            self._mark_wanted()
        for edge in output.edges:
            edge.book.produced += 1
            stage = edge.target
            if stage.stopped:
                self._drop(edge, message, Reason.STAGE_STOPPED)
                self._tell_took(edge, message)
            elif self._stopping:
                self._drop(edge, message, Reason.END)
                self._tell_took(edge, message)
            elif edge.period is not None and edge.decimates(message.stamp):
                self._drop(edge, message, Reason.DECIMATED)
            elif edge.slot is None:
                self._arrive(edge, message)
            else:
                self._offer(edge, edge.slot, message)

    def _offer(self, edge: Edge, slot: Slot, message: Message[Any]) -> None:
        stage = edge.target
        was_stale = slot.stale
        assert stage.sync is not None
        if stage.sync.offer(slot, message, self._now):
            self._mark(stage)
        if was_stale and not slot.stale:
            text = "messages arrive in time again"
            self._event("recovered", edge.name, text)

    def _arrive(self, edge: Edge, message: Message[Any]) -> None:
        """A trigger arrives at its stage: into its queue, or its group's undecided frame."""
        stage = edge.target
        last, stage.trigger_last = stage.trigger_last, message.stamp
        entry = WaitingSet(message, self._now, 0 if last is None else message.stamp - last)
        if stage.sync is not None:
            stage.sync.arrived(entry)
        if stage.wishes is not None and not self._wants(stage, entry):
            self._drop(edge, message, Reason.NOT_WANTED)
        elif stage.group is not None:
            replaced = stage.group.undecided.get(stage.index)
            stage.group.undecided[stage.index] = entry
            if replaced is not None:
                self._drop_trigger(stage, replaced, Reason.REPLACED)
        else:
            lost = stage.queue.put(entry)
            if lost is not None:
                self._drop_trigger(stage, *lost)
        self._triggers_changed(stage)
        self._mark(stage)

    def _wants(self, stage: StageState, entry: WaitingSet) -> bool:
        """Judge a frame that arrives at a stage with `wanted` (README, section 10)."""
        assert stage.wishes is not None
        stage.frames.add(entry.stamp, self._now)
        self._mark_wanted()
        entry.verdict = stage.wishes.verdict(stage.frames)
        if entry.verdict is not Verdict.MAY or self._offline:
            return entry.verdict is not Verdict.NO
        held = stage.undecided() if stage.group else next(iter(stage.queue.entries), None)
        return held is None or held.verdict is Verdict.MAY

    def _mark_wanted(self) -> None:
        """What is predicted changed: a frame that had to make way may have the time now."""
        if not self._offline:
            for stage in self._wanted:
                self._mark(stage)

    def _deliver_slots(self, stage: StageState, sync: Synchronizer) -> None:
        """Book every message of the set that was just taken: delivered once, then reused."""
        for edge in stage.synced_edges:
            slot = edge.slot
            assert slot is not None
            for index in sync.chosen(slot):
                if slot.used[index]:
                    edge.book.reused += 1
                else:
                    slot.used[index] = True
                    edge.book.delivered += 1

    def _drop(self, edge: Edge, message: Message[Any], reason: Reason) -> None:
        edge.book.drop(reason)
        self._observer.dropped(
            edge.origin.port, edge.target.node.name, edge.input.name, message, reason, self._now
        )

    def _drop_trigger(self, stage: StageState, entry: WaitingSet, reason: Reason) -> None:
        """Drop a trigger that was held; a missed wish is told."""
        assert stage.producer is not None
        self._drop(stage.producer, entry.message, reason)
        missed = (Reason.REPLACED, Reason.TOO_OLD, Reason.DECIMATED)
        if entry.verdict is Verdict.MUST and reason in missed:
            text = f"the frame at stamp {entry.stamp} was wanted and ended {reason}"
            self._event("wish_missed", stage.node.name, text)

    # ------------------------------------------------------------------ other processes

    def notices(self) -> list[Notice]:
        """What other processes should know since this was asked last (README, section 11)."""
        notices, self._took = self._took, []
        for stage in self._senders:
            bound = stage.ports[0].bound
            if stage.idle and not stage.runs and bound > self._said.get(stage.node.name, NEVER):
                self._said[stage.node.name] = bound
                notices.append(Bound(stage.node.name, bound))
        return notices

    def _tell_took(self, edge: Edge, message: Message[Any]) -> None:
        """Another process waits until its messages have found a place here."""
        origin = self._by_name[edge.origin.port.stage].node
        if origin.role is Role.REMOTE and edge.input.policy is Policy.BLOCK:
            self._took.append(Took(edge.origin.port, edge.target.node.name, message.seq))

    # ------------------------------------------------------------------ bounds

    def _raise(self, output: OutputPort, bound: int) -> None:
        """The bound of a port rises (it never falls) and whoever looks at it hears of it."""
        if bound <= output.bound:
            return
        output.bound = bound
        ended = bound >= INFINITY
        if ended:
            self._mark_wanted()
        for edge in output.edges:
            stage = edge.target
            if stage.stopped:
                continue
            if edge.slot is not None:
                assert stage.sync is not None
                if stage.sync.bound(edge.slot, INFINITY if ended else bound + edge.slot.offset):
                    self._mark(stage)
            elif stage.sync is not None or stage.watched or ended:
                self._triggers_changed(stage)

    def _triggers_changed(self, stage: StageState) -> None:
        """What is queued, waiting or still to come at a stage changed: prune, raise its outputs."""
        if stage.sync is not None:
            stage.sync.lower(stage.least_set())
        self._outputs_changed(stage)

    def _outputs_changed(self, stage: StageState) -> None:
        producer = stage.producer
        if stage.watched or stage.stopped or (producer is not None and producer.origin.ended):
            least = stage.least_output()
            for port in stage.ports:
                self._raise(port, max(port.last + 1, least))

    def _mark(self, stage: StageState) -> None:
        """Look at a stage again before this event is over."""
        if not stage.dirty:
            stage.dirty = True
            heappush(self._dirty, stage.index)

    def _blocked(self, stage: StageState) -> bool:
        """An out edge with `policy: block` has no room for another result."""
        coming = len(stage.runs)
        for edge in stage.blocking:
            if edge.target.queue.blocks(coming) and not edge.target.stopped:
                return True
        return False

    # ------------------------------------------------------------------ triggers

    def _head(self, stage: StageState) -> WaitingSet | None:
        """The next trigger of a stage; an undecided frame counts once its group can decide."""
        group = stage.group
        entry: WaitingSet | None = None
        if stage.queue.entries:
            entry = stage.queue.entries[0]
            if group is not None:  # decided for: not asked again
                return entry
        elif group is not None and stage.live and group.decidable():
            entry = group.undecided.get(stage.index)
        if entry is None or entry.verdict is not Verdict.MAY or self._offline:
            return entry
        return entry if self._has_time(stage, entry.stamp) else None

    def _has_time(self, stage: StageState, stamp: int) -> bool:
        """Whether a run on a frame that nobody must have ends before the next one that must be."""
        takers = [s for s in stage.group.members if s.live] if stage.group else [stage]
        for device in {taker.device for taker in takers} - {None}:
            assert device is not None
            used = sum(device.usual_ns(s.node.name) for s in takers if s.device is device)
            for rival in device.stages:
                if rival.wishes is None or rival.device is not device or not rival.expecting:
                    continue
                due = rival.wishes.next_must(rival.frames, stamp)
                if due is not None and device.free_at(self._now) + used > due:
                    return False
        return True

    def _pop_head(self, stage: StageState) -> WaitingSet:
        """Take the next trigger out of the queue; decides the group's frame if it must."""
        if not stage.queue.entries:
            self._decide(stage)
        entry = stage.queue.entries.popleft()
        if stage.group is not None and not stage.queue.entries:
            for member in stage.group.members:
                self._mark(member)
        self._made_room(stage, entry)
        return entry

    def _made_room(self, stage: StageState, last: WaitingSet | None) -> None:
        """A queue got shorter, up to `last`: with `policy: block` its producer may go on."""
        edge = stage.producer
        if edge is not None and edge.input.policy is Policy.BLOCK:
            if last is not None:
                self._tell_took(edge, last.message)
            self._mark(self._by_name[edge.origin.port.stage])

    def _decide(self, stage: StageState) -> None:
        """The group decides for its newest frame: every live member will take it."""
        group = stage.group
        assert group is not None
        frames, group.undecided = group.undecided, {}
        for member in group.members:
            entry = frames.get(member.index)
            if entry is None:
                continue
            if member.live:
                member.queue.entries.append(entry)
            else:
                self._drop_trigger(member, entry, Reason.REPLACED)
                self._triggers_changed(member)
            self._mark(member)

    def _fill_waiting(self, stage: StageState, sync: Synchronizer) -> None:
        """Drop sets that miss a required input; let triggers wait, up to four; a fifth forces."""
        while True:
            room = stage.free and not (self._stopping or stage.stopped)
            more = room and self._head(stage) is not None
            if sync.waiting:
                full = len(sync.waiting) >= MAX_WAITING
                sync.waiting[0].forced = full and more and not self._offline
                if sync.ready(self._now) and sync.skips:
                    entry = sync.waiting[0]
                    self._stale(stage, sync.take()[1])
                    self._trigger_lost(stage, entry, Reason.SET_SKIPPED)
                    continue
                if full:
                    return
            if not more:
                return
            sync.open(self._pop_head(stage))

    def _stale(self, stage: StageState, slots: Sequence[Slot]) -> None:
        for slot in slots:
            name = next(edge.name for edge in stage.synced_edges if edge.slot is slot)
            text = "not in time within max_wait_ms: sets no longer wait for it, until it is again"
            self._event("stale", name, text)

    def _trigger_lost(self, stage: StageState, entry: WaitingSet, reason: Reason) -> None:
        self._drop_trigger(stage, entry, reason)
        self._triggers_changed(stage)
        self._mark(stage)

    # ------------------------------------------------------------------ ends

    def _drop_queue(self, stage: StageState, reason: Reason) -> None:
        """Drop the triggers that no set has taken."""
        lost = list(stage.queue.entries)
        stage.queue.entries.clear()
        for entry in lost:
            self._drop_trigger(stage, entry, reason)
        self._made_room(stage, lost[-1] if lost else None)
        self._triggers_changed(stage)

    def _drop_slots(self, stage: StageState, reason: Reason) -> None:
        if stage.sync is not None:
            for slot in stage.sync.slots:
                slot.release(len(slot), reason)

    def _drop_triggers(self, stage: StageState, reason: Reason) -> None:
        """Drop every trigger that the stage has not started on."""
        edge = stage.producer
        if edge is None:
            return
        waiting = list(stage.sync.waiting) if stage.sync is not None else []
        if (undecided := stage.undecided()) is not None and stage.group is not None:
            del stage.group.undecided[stage.index]
            waiting.append(undecided)
        if stage.sync is not None:
            stage.sync.waiting.clear()
        for entry in waiting:
            self._drop(edge, entry.message, reason)
        self._drop_queue(stage, reason)
