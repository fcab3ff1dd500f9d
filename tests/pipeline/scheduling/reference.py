"""The scheduler by definition: the rules of pipeline/scheduling/README.md, brute force.

`reference_streams` holds what happens to messages (sections 1 to 5 and 9), `reference_devices` when
a device is free or lost (7), `reference_wanted` which frames are wanted (10); here is what is
started where, and how it ends (6 to 8). After every event all rules are applied until nothing
changes any more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf
from typing import Any, TypeAlias

from reference_streams import WAITING_SETS, Item, Job
from reference_wanted import Wanted

from pipeline.message import Message, Sample
from pipeline.scheduling.events import Check, Output, Reason, Refusal, Run, Start, Step
from pipeline.scheduling.topology import OnError, Port, StageNode

Offer: TypeAlias = tuple[StageNode, Job | Item]


class ReferenceScheduler(Wanted):
    """What `Scheduler` must do, event by event."""

    # What drivers call

    def publish(self, port: Port, message: Message[Any], now: int) -> list[Start]:
        refusal = self._refusal(port, message)
        if refusal is not None:
            self.outlets[port].promised &= refusal is not Refusal.EARLY
            self.observer.refused(port, message, refusal, now)
            return []
        self.now = now
        own = (Sample(str(port), message.stamp, now),)
        self._send(port, replace(message, received=now, lineage=message.lineage or own))
        return self._act()

    def step_done(self, run: Run, now: int, outputs: Sequence[Output] | None = None) -> list[Start]:
        self.now, job = now, self._running(run)
        if job is None:
            return self._act()
        self.took.append((run.stage, job.step, run.device, now - job.since))
        job.running, job.outputs = False, outputs or ()
        if job.step in (Step.PROCESS, Step.FINISH):
            job.how = "finished"
        else:
            job.step = Step.INFER if job.step is Step.PREPARE else Step.FINISH
        return self._step_over(job)

    def step_failed(self, run: Run, now: int) -> list[Start]:
        self.now, job = now, self._running(run)
        if job is None:
            return self._act()
        job.running, job.how = False, "failed"
        return self._step_over(job)

    def _running(self, run: Run) -> Job | None:
        """Results of runs given up, and of an infer taken to another device, are ignored."""
        return next((job for job in self.jobs[run.stage] if job.run is run and job.running), None)

    def _step_over(self, job: Job) -> list[Start]:
        if job.doomed or job.run.stage in self.stopped:
            job.how = "abandoned"
        self._leave(self.node[job.run.stage])
        return self._act()

    def time(self, now: int) -> list[Start | Check]:
        self.now = now
        for device in self._hung():
            self.observer.event("device_hung", device, "", now)
            self._lose(device)
        return [*self._act(), *self._checks()]

    def source_ended(self, stage: str, now: int) -> list[Start]:
        self.now = now
        self.ended.add(stage)
        return self._act()

    def device_up(self, device: str, now: int) -> list[Start]:
        self.now = now
        if device in self.down:
            self._comes_up(device)
        return self._act()

    def device_checked(self, device: str, ok: bool, now: int) -> list[Start]:
        self.now = now
        self._checked(device, ok)
        return self._act()

    def device_down(self, device: str, now: int) -> list[Start]:
        self.now = now
        self._lose(device)
        return self._act()

    def device_failed(self, run: Run, now: int) -> list[Start]:
        self.now, job = now, self._running(run)
        if job is not None and job.step is Step.INFER:
            self.observer.event("device_failed", str(run.device), "", now)
            self._lose(str(run.device), job)
        return self._act()

    def stop(self, now: int) -> list[Start]:
        self.now, self.stopping = now, True
        self._drop_everything(self.edges, Reason.END)
        return self._act()

    def abandon(self, now: int) -> list[Start]:
        self.stop(now)
        for node in self.nodes:
            for job in self._in_flight(node):
                job.running = False
                job.how = "failed" if job.how == "failed" else "abandoned"
            self._leave(node)
        return []

    def ready(self, source: str) -> bool:
        return not self._blocked(self.node[source])

    def quiescent(self) -> bool:
        return not any(job.running for jobs in self.jobs.values() for job in jobs)

    def next_wakeup(self) -> int | None:
        only_time = [self._overdue_at(device) for device in self.devices]
        only_time += [] if self.stopping else self.check_due.values()
        instants: list[float] = []
        for node in self.nodes:
            for edge in self._slots(node):
                instants += [self._deadline(edge, t) for t in self._trigger(node).held("waiting")]
            if (device := self._device(node)) is not None:
                instants.append(self._free_at(device) - self._prepare_time(node))
        instants = only_time + [at for at in instants if self.now < at]
        return min((int(at) for at in instants if at < inf), default=None)

    # 6. Starting

    def _act(self) -> list[Start]:
        starts: list[Start] = []
        while self._prune() or self._infer(starts) or self._move() or self._start_next(starts):
            pass
        return starts

    def _move(self) -> bool:
        """One trigger from its queue to the waiting sets, or one skipped set."""
        for node in self.nodes:
            if node.is_source or not self._slots(node):
                continue
            trigger = self._trigger(node)
            waiting = trigger.held("waiting")
            choice = self._choose(node, waiting[0]) if waiting else None
            if choice is not None and choice.skip:
                self._mark_stale(choice.timed_out)
                self._drop(trigger, waiting[0], Reason.SET_SKIPPED)
                return True
            head = self._head(node)
            if head is not None and self._has_room(node) and len(waiting) < WAITING_SETS:
                self._take(node, head)
                head.place = "waiting"
                return True
        return False

    def _candidate(self, node: StageNode) -> Item | None:
        """The trigger of the set that the stage would start now, apart from workers."""
        if not self._has_room(node) or self._blocked(node):
            return None
        if node.devices and not self._device_lets(node):
            return None
        if not self._slots(node):
            return self._head(node)
        waiting = self._trigger(node).held("waiting")
        return waiting[0] if waiting and self._choose(node, waiting[0]) is not None else None

    def _start_next(self, starts: list[Start]) -> bool:
        """The first of the CPU steps that could start; those that need no worker before others."""
        busy = [
            job
            for node in self.nodes
            for job in self._in_flight(node)
            if job.running and job.step is not Step.INFER and not node.inline
        ]
        offers = list(self._offers(worker_free=len(busy) < self.workers))
        for device in self.devices:
            rivals = [
                (n, item)
                for n, item in offers
                if isinstance(item, Item) and self._device(n) == device
            ]
            turns = sorted(rivals, key=self._turn)
            in_time = turns[:1] if turns and self._in_time(turns[0][0]) else []
            offers = [offer for offer in offers if offer not in rivals or offer in in_time]
        for node, offer in sorted(offers, key=self._urgency)[:1]:
            if isinstance(offer, Job):
                starts.append(self._begin(node, offer))
            else:
                self._start_run(node, offer, starts)
            return True
        return False

    def _turn(self, rival: tuple[StageNode, Item]) -> tuple[int, bool, int, int]:
        node, item = rival
        return -node.priority, item.verdict == "may", self._last_turn(node), self.nodes.index(node)

    def _offers(self, worker_free: bool) -> Iterator[Offer]:
        for node in self.nodes:
            jobs = self._in_flight(node)
            stepping = any(job.running and job.step is not Step.INFER for job in jobs)
            if node.is_source or not (worker_free or node.inline):
                continue
            if stepping and not node.stateless:
                continue
            for job in jobs:
                if job.step is Step.FINISH and not job.running and not job.how:
                    yield node, job
            item = self._candidate(node)
            if item is not None:
                yield node, item

    def _urgency(self, offer: Offer) -> tuple[bool, int, bool, int, int]:
        node, what = offer
        stamp = what.stamp if isinstance(what, Job) else what.s
        return (
            not node.inline,
            -node.priority,
            isinstance(what, Item),
            stamp,
            self.nodes.index(node),
        )

    def _start_run(self, node: StageNode, item: Item, starts: list[Start]) -> None:
        trigger = self._trigger(node)
        self._take(node, item)
        if self._too_old(node, item.s):
            self._drop(trigger, item, Reason.TOO_OLD)
            return
        if self._too_soon(node, item):
            self._drop(trigger, item, Reason.DECIMATED)
            return
        choice = self._choose(node, item)
        assert choice is not None
        self._mark_stale(choice.timed_out)
        inputs = self._input_set(node, item, choice)
        item.place = ""
        for used in [item, *(used for found, _ in choice.shares.values() for used in found)]:
            used.uses += 1
        number, device = len(self.jobs[node.name]), self._device(node)
        step = Step.PREPARE if node.devices else Step.PROCESS
        job = Job(Run(node.name, number, inputs, self.now, device), step)
        self.jobs[node.name].append(job)
        self.turns.append(node.name)
        self.observer.set_formed(node.name, inputs, self.now)
        starts.append(self._begin(node, job))

    def _begin(self, node: StageNode, job: Job) -> Start:
        job.running, job.since = True, self.now
        return Start(job.run, job.step, node.inline and job.step is not Step.INFER)

    def _too_old(self, node: StageNode, stamp: int) -> bool:
        limit = self._trigger(node).input.max_age
        return not self.offline and limit is not None and self.now - stamp > limit

    def _too_soon(self, node: StageNode, item: Item) -> bool:
        """On a lower rung a stage may have a longer period."""
        jobs, period = self.jobs[node.name], node.degraded_period
        if period is None or not jobs or self._device(node) in (None, *node.devices[:1]):
            return False
        return item.s < jobs[-1].stamp + period - item.gap // 2

    # 7. Devices

    def _infer(self, starts: list[Start]) -> bool:
        """Start the infer of one prepared run, or abandon it for its age."""
        prepared = [
            (self.node[job.run.stage], job)
            for job in self._all_in_flight()
            if job.step is Step.INFER and not job.running and not job.how
        ]
        for node, job in sorted(prepared, key=self._urgency):
            if self._inferring(job.run.device) is None:
                if self._too_old(node, job.stamp):
                    job.how = "abandoned"
                    self._leave(node)
                else:
                    starts.append(self._begin(node, job))
                return True
        return False

    def _lose(self, device: str, failed: Job | None = None) -> None:
        if device in self.down:
            return
        self._goes_down(device)
        for node in self.nodes:
            for job in self._in_flight(node):
                if job.run.device == device and self._needs_device(job):
                    self._leave_device(node, job)
                    if job is failed and job.how and node.name not in self.stopped:
                        job.how = "failed"
            self._leave(node)
            if not node.is_source and not self._live(node):
                for frame in self._trigger(node).held("decided"):
                    self._drop(self._trigger(node), frame, Reason.REPLACED)

    def _leave_device(self, node: StageNode, job: Job) -> None:
        """The job's device is lost: on to a later rung, or given up."""
        later = node.devices[node.devices.index(str(job.run.device)) + 1 :]
        rung = next((device for device in later if device not in self.down), None)
        if rung is None or job.doomed or node.name in self.stopped:
            job.doomed = job.running and job.step is Step.PREPARE
            if not job.doomed:
                job.running, job.how = False, "abandoned"
        elif job.running and job.step is Step.INFER:
            job.run, job.running = replace(job.run, device=rung), False
        else:
            job.run.device = rung

    # 8. Ends of runs

    def _leave(self, node: StageNode) -> None:
        """Runs leave in trigger order, each with all that it says."""
        for job in self._in_flight(node):
            if not job.how:
                return
            if job.how == "finished" and not self._outputs_hold(node, job):
                job.how = "failed"
            if job.how == "finished" and node.outputs and not job.outputs:
                job.how = "filtered"
            job.left = True
            self.observer.run_ended(job.run, job.how, self.now)
            if job.how == "finished":
                for output in job.outputs:
                    self._send(
                        Port(node.name, node.outputs[output.port]), self._message(node, job, output)
                    )
            if job.how == "failed" and node.on_error is OnError.STOP:
                self._stop_stage(node)

    def _stop_stage(self, node: StageNode) -> None:
        self.stopped.add(node.name)
        self._drop_everything([*self._slots(node), self._trigger(node)], Reason.STAGE_STOPPED)
        for job in self._in_flight(node):
            if not job.running:
                job.how = "failed" if job.how == "failed" else "abandoned"

    def _outputs_hold(self, node: StageNode, job: Job) -> bool:
        """Whether the ports would take all that the run says."""
        said = [(self._message(node, job, output), output.port) for output in job.outputs]
        return all(
            message.stamp >= job.stamp
            and message.stamp > self.outlets[Port(node.name, node.outputs[port])].last
            and self._extent_holds(message)
            for message, port in said
        )

    def _message(self, node: StageNode, job: Job, output: Output) -> Message[Any]:
        trigger = job.run.inputs.trigger
        stamp, begin, end = output.stamp, output.begin, output.end
        if stamp is None:
            stamp, begin, end = trigger.stamp, trigger.begin, trigger.end
        message = Message.at(stamp, output.payload, begin=begin, end=end, received=self.now)
        used = self._messages(job.run.inputs)
        lower = job.run.device is not None and job.run.device != node.devices[0]
        return replace(
            message,
            lineage=tuple({sample: None for one in used for sample in one.lineage}),
            executor=job.run.device,
            degraded=lower or any(one.degraded for one in used),
        )

    def runs(self) -> dict[str, dict[str, int]]:
        books = {}
        for node in (node for node in self.nodes if not node.is_source):
            ends = [job.how if job.left else "running" for job in self.jobs[node.name]]
            kinds = ("finished", "filtered", "failed", "abandoned", "running")
            books[node.name] = {"started": len(ends), **{kind: ends.count(kind) for kind in kinds}}
        return books
