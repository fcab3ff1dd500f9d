"""The scheduler: a pure state machine that says which step of which stage runs next, and on what.

No threads, no clock, no I/O. A driver brings events (`publish`, `step_done`, `time` ...), executes
the `Start` actions that come back, and brings their results. README.md in this folder has the
rules. `Streams` knows what happens to messages (sections 1 to 5), `Runs` what happens to runs once
they have begun (7 and 8); this file is what begins next (6): every event enters the books first,
then `_start_what_can` begins every step that may.
"""

from __future__ import annotations

from bisect import insort
from collections import deque
from collections.abc import Sequence
from heapq import heappop
from operator import attrgetter
from typing import Any

from pipeline.message import Message, Sample
from pipeline.scheduling.books import Books
from pipeline.scheduling.bounds import INFINITY
from pipeline.scheduling.devices import HISTORY, Device
from pipeline.scheduling.edges import Edge
from pipeline.scheduling.events import (
    Check,
    InputSet,
    Observer,
    Output,
    Reason,
    Refusal,
    Run,
    Start,
    Step,
)
from pipeline.scheduling.runs import Runs
from pipeline.scheduling.stages import ActiveRun, StageState
from pipeline.scheduling.sync import Slot, WaitingSet
from pipeline.scheduling.topology import Port, Topology
from pipeline.scheduling.waits import Wait, waits_of
from pipeline.scheduling.wanted import Verdict


class Scheduler(Runs):
    """One graph's scheduler. Not thread-safe: one lock of the driver owns it."""

    def __init__(
        self, topology: Topology, *, offline: bool = False, observer: Observer | None = None
    ) -> None:
        super().__init__(topology, offline=offline, observer=observer)
        self.books = Books(self._stages, list(self._ports.values()))
        self._wanting: dict[int, StageState] = {}  #: stages that may want a CPU worker, by index
        self._synced = [stage for stage in self._stages if stage.sync]
        self._timed = bool(self._synced or self._devices)
        self._wakeup = INFINITY  #: the least instant at which something becomes due
        self._lateness: deque[int] = deque([0], maxlen=HISTORY)  #: of the last wake-ups

    # ------------------------------------------------------------------ events

    def publish(self, port: Port, message: Message[Any], now: int) -> list[Start]:
        """A source brings a message; a refused one is counted and changes nothing else."""
        self._begin(now)
        output = self._ports[port]
        reason = output.refusal(message)
        if reason is not None:
            self._observer.refused(port, message, reason, now)
            if reason is Refusal.EARLY and output.min_period is not None:
                output.min_period = None
                text = "a message came before the promised min_period_ms; the promise is withdrawn"
                self._event("promise_withdrawn", str(port), text)
            return self._starts
        taken = Message(
            message.payload,
            message.stamp,
            message.begin,
            message.end,
            now,
            output.published,
            message.lineage or (Sample(output.name, message.stamp, now),),
            message.executor,
            message.degraded,
        )
        self._send(output, taken)
        self._raise(output, output.promised_after(message.stamp))
        return self._start_what_can()

    def arrived(self, port: Port, message: Message[Any], now: int) -> list[Start]:
        """Another process brings a message of a port of its own, as it was published there."""
        self._begin(now)
        output = self._ports[port]
        reason = output.refusal(message)
        if reason is not None:
            self._observer.refused(port, message, reason, now)
            return self._starts
        self._send(output, message)
        self._raise(output, message.stamp + 1)
        return self._start_what_can()

    def bounded(self, port: Port, bound: int, now: int) -> list[Start]:
        """Another process says that nothing below `bound` will come on a port of its own."""
        self._begin(now)
        self._raise(self._ports[port], bound)
        return self._start_what_can()

    def source_ended(self, stage: str, now: int) -> list[Start]:
        """A source has no more messages."""
        self._begin(now)
        for output in self._by_name[stage].ports:
            self._raise(output, INFINITY)
        return self._start_what_can()

    def step_done(self, run: Run, now: int, outputs: Sequence[Output] | None = None) -> list[Start]:
        """A step is over; `outputs` is what the last step of a run says."""
        self._begin(now)
        active, stage, step = self._step_over(run)
        if active is None:
            return self._start_what_can()
        if step is Step.PREPARE:
            stage.measured_prepare(now - active.step_started)
        if active.doomed:
            self._end(stage, active, "abandoned")
        elif step is Step.PREPARE:
            active.prepared, active.prepared_at = True, now
            self._serve(self._devices[str(active.device)])
        elif step is Step.INFER:
            # Two devices, after one came back, may end their infers out of order.
            insort(stage.finishing, active, key=attrgetter("number"))
        else:
            self._finish(stage, active, outputs or ())
        self._serve_next(run, step)
        self._mark(stage)
        return self._start_what_can()

    def step_failed(self, run: Run, now: int) -> list[Start]:
        """A step raised."""
        self._begin(now)
        active, stage, step = self._step_over(run, failed=True)
        if active is not None:
            self._end(stage, active, "abandoned" if active.doomed else "failed")
            self._serve_next(run, step)
            self._mark(stage)
        return self._start_what_can()

    def time(self, now: int) -> list[Start | Check]:
        """A wake-up: deadlines may have passed."""
        if now >= self._wakeup:
            self._lateness.append(now - self._wakeup)
        self._begin(now)
        checks: list[Start | Check] = []
        for device in self._devices.values() if not self._offline else ():
            if device.overdue_at is not None and device.overdue_at <= now:
                self._hung(device)
        for device in self._devices.values() if not self._stopping else ():
            if device.check_due is not None and device.check_due <= now:
                device.check()
                checks.append(Check(device.name))
        return self._start_what_can() + checks

    def device_failed(self, run: Run, now: int) -> list[Start]:
        """The infer of a run raised: its device is lost, the run goes on along its ladder."""
        self._begin(now)
        assert isinstance(run, ActiveRun)
        device = self._devices[str(run.device)]
        if device.inferring is run:
            self._event("device_failed", device.name, f"an infer of {run.stage} failed on it")
            self._lose(device, "failed")
        return self._start_what_can()

    def device_checked(self, device: str, ok: bool, now: int) -> list[Start]:
        """The answer to a `Check`."""
        self._begin(now)
        checked = self._devices[device]
        if checked.checking and ok:
            self._restore(checked)
        elif checked.checking:
            checked.still_lost(now)
        return self._start_what_can()

    def device_down(self, device: str, now: int) -> list[Start]:
        """A device is gone: its runs move to the next rung that is up, or end here."""
        self._begin(now)
        self._lose(self._devices[device], "abandoned")
        return self._start_what_can()

    def device_up(self, device: str, now: int) -> list[Start]:
        """A device is back."""
        self._begin(now)
        if not self._devices[device].up:
            self._restore(self._devices[device])
        return self._start_what_can()

    def stop(self, now: int) -> list[Start]:
        """Start no new run; what is queued, waiting or held ends here. Runs in flight go on."""
        self._begin(now)
        self._stopping = True
        for stage in self._stages:  # slots first: a dropped trigger would prune them downstream
            self._drop_slots(stage, Reason.END)
        for stage in self._stages:
            self._drop_triggers(stage, Reason.END)
        return self._start_what_can()

    def abandon(self, now: int) -> list[Start]:
        """Give up the runs in flight; late results of them are ignored."""
        self._begin(now)
        for stage in self._stages:
            for run in stage.runs:
                if run.ended != "failed":
                    run.ended = "abandoned"
            stage.finishing.clear()
            self._commit(stage)
        for device in self._devices.values():
            device.pending.clear()
            device.inferring = device.overdue_at = None
        return self._starts

    # ------------------------------------------------------------------ questions

    def ready(self, source: str) -> bool:
        """Whether a source may bring its next message (no blocked edge)."""
        return not self._blocked(self._by_name[source])

    def has_later_rung(self, run: Run) -> bool:
        """Whether a run would go on if its device were lost now."""
        assert isinstance(run, ActiveRun)
        return not run.doomed and self._later_rung(run, self._devices[str(run.device)]) is not None

    def quiescent(self) -> bool:
        """Nothing runs; without a further event nothing will."""
        return not any(stage.runs for stage in self._stages)

    def next_wakeup(self) -> int | None:
        """The least instant at which `time` could do something."""
        return None if self._wakeup >= INFINITY else self._wakeup

    def stopped(self, stage: str) -> bool:
        """The stage stopped after a failure."""
        return self._by_name[stage].stopped

    def waits(self, stage: str) -> list[Wait]:
        """The triggers that a stage holds, with what each waits for, the next one first."""
        state = self._by_name[stage]
        blocked = self._blocked(state)
        return list(waits_of(state, blocked=blocked, workers=self._free_workers))

    def slots(self, stage: str) -> Sequence[tuple[Edge, Slot]]:
        """The sync edges of a stage with their slots, in the order of the file; read only."""
        edges = self._by_name[stage].synced_edges
        return [(edge, edge.slot) for edge in edges if edge.slot is not None]

    def ledger(self) -> dict[str, dict[str, Any]]:
        """Every edge's book by ``stage/port->stage/input``."""
        return self.books.ledger()

    def runs(self) -> dict[str, dict[str, int]]:
        """Every stage's book of runs."""
        return self.books.runs()

    def devices(self) -> dict[str, Device]:
        """The devices by name; read only."""
        return self._devices

    def _begin(self, now: int) -> None:
        """Every event starts here: what has become due by now is looked at again."""
        self._now = now
        self._starts = []
        self._state += 1
        if now < self._wakeup:
            return
        for stage in self._synced:
            if stage.sync is not None and stage.sync.next_deadline() <= now:
                self._mark(stage)
        for device in self._devices.values():
            if device.wakeup is not None and device.wakeup <= now:
                device.wakeup = None
                self._mark_device(device)

    # ------------------------------------------------------------------ starting

    def _start_what_can(self) -> list[Start]:
        """Begin every step that may begin now; the end of every event."""
        while True:
            while self._dirty:
                stage = self._stages[heappop(self._dirty)]
                stage.dirty = False
                if stage.inputs and not stage.idle:
                    self._look_at(stage)
            if not (self._wanting and self._free_workers and self._use_worker()):
                break
        if self._timed:
            self._wakeup = self._next_due()
        return self._starts

    def _look_at(self, stage: StageState) -> None:
        """Let triggers wait; an inline stage starts at once, any other wants a worker."""
        if stage.sync is not None:
            self._fill_waiting(stage, stage.sync)
            self._state += 1
        if not stage.inline:
            self._wanting[stage.index] = stage
        elif self._start_cpu_step(stage) and stage.free:
            self._mark(stage)

    def _next_due(self) -> int:
        due = INFINITY
        for stage in self._synced:
            if stage.sync is not None and (at := stage.sync.next_deadline()) < due:
                due = at
        for device in self._devices.values():
            if (at := device.due()) < due:
                due = at
        return due

    def _use_worker(self) -> bool:
        """Give a free CPU worker to the stage that wants it most; False where none can use it.

        One step at a time: what it changes may bring another stage to want the next worker more.
        """
        wanting = list(self._wanting.values())
        if len(wanting) > 1:
            keyed = [key for stage in wanting if (key := self._step_key(stage)) is not None]
            wanting = [self._stages[key[-1]] for key in sorted(keyed)]
            self._wanting = {stage.index: stage for stage in wanting}
        for best in wanting:
            started = self._start_cpu_step(best)
            if not started or not best.stateless:  # it asks again when its step is over
                del self._wanting[best.index]
            if started or self._dirty:
                return True
        return False

    def _step_key(self, stage: StageState) -> tuple[int, int, int, int] | None:
        """What a stage wants a worker for, as a sort key (README, section 6); None: nothing."""
        if stage.cpu_steps and not stage.stateless:
            return None
        priority = -stage.priority
        if stage.finishing:
            return priority, 0, stage.finishing[0].stamp, stage.index
        entry = self._next_trigger(stage)
        return None if entry is None else (priority, 1, entry.stamp, stage.index)

    def _start_cpu_step(self, stage: StageState) -> bool:
        if stage.cpu_steps and not stage.stateless:
            return False
        if stage.finishing:
            self._start_step(stage, stage.finishing.popleft(), Step.FINISH)
            return True
        return self._try_process(stage)

    def _try_process(self, stage: StageState) -> bool:
        """Start the stage's next run if it can; True where something changed."""
        entry = self._next_trigger(stage)
        if entry is None or (stage.ladder and not self._device_turn(stage, entry)):
            return False
        reason = self._unfit(stage, entry)
        if reason is not None:
            self._state += 1
            self._pop_trigger(stage)
            self._trigger_lost(stage, entry, reason)
            if stage.device is not None:
                self._mark_device(stage.device)  # the turn may be another stage's now
            return True
        if stage.sync is None:
            self._pop_trigger(stage)
            self._start_run(stage, InputSet(entry.message, (entry.message,)))
            return True
        inputs, stale = stage.sync.take()
        self._stale(stage, stale)
        self._deliver_slots(stage, stage.sync)
        self._start_run(stage, inputs)
        return True

    def _unfit(self, stage: StageState, entry: WaitingSet) -> Reason | None:
        """Why a trigger is dropped instead of started; None where it is started."""
        if self._offline:
            return None
        if stage.max_age is not None and self._now - entry.stamp > stage.max_age:
            return Reason.TOO_OLD
        period = stage.node.degraded_period
        if period is None or stage.last_stamp is None or not stage.degraded:
            return None
        too_soon = entry.stamp < stage.last_stamp + period - entry.gap // 2
        return Reason.DECIMATED if too_soon else None

    def _next_trigger(self, stage: StageState) -> WaitingSet | None:
        """The trigger of the set that the stage could start now, worker and device apart."""
        if stage.stopped or self._stopping or len(stage.runs) >= stage.max_in_flight:
            return None
        if stage.ladder and ((device := stage.device) is None or device.pending):
            return None
        if stage.sync is not None:
            if not stage.sync.ready(self._now):
                return None
            entry = stage.sync.waiting[0]
        else:
            head = self._head(stage)
            if head is None:
                return None
            entry = head
        return None if stage.blocking and self._blocked(stage) else entry

    def _pop_trigger(self, stage: StageState) -> None:
        """Take the trigger that is about to start (or to be dropped) from where it waits."""
        if stage.sync is not None:
            stage.sync.waiting.popleft()
        else:
            self._pop_head(stage)

    def _device_turn(self, stage: StageState, entry: WaitingSet) -> bool:
        """Whether it is the stage's turn on its device: by priority, then least recently started.

        The turn is decided first and the time for it after: were each stage let in as soon as its
        own prepare time allows, the one with the longest prepare would take every turn.
        """
        device = stage.device
        assert device is not None
        if device.shut == self._state:
            return False
        turns = []
        for rival in device.stages:
            if rival is not stage:
                if rival.device is not device or (rival.cpu_steps and not rival.stateless):
                    continue
                other = self._next_trigger(rival)
            else:
                other = entry
            if other is not None:
                may = other.verdict is Verdict.MAY
                turns.append((-rival.priority, may, rival.last_started, rival.index))
        turn = self._stages[min(turns)[-1]]
        if not self._offline:
            start_at = device.free_at(self._now) - turn.prepare_ns - max(self._lateness)
            if start_at > self._now:
                device.wakeup = start_at
                device.shut = self._state
                return False
        if turn is not stage:
            self._mark(turn)
            return False
        return True
