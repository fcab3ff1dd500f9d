"""Runs: how they begin on workers and devices, move where a device is lost, and end.

Sections 7 and 8 of README.md in this folder; `Scheduler` says which run begins next.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pipeline.message import Message, Sample
from pipeline.scheduling.bounds import INFINITY, OutputPort
from pipeline.scheduling.devices import Device
from pipeline.scheduling.events import InputSet, Observer, Output, Reason, Refusal, Run, Start, Step
from pipeline.scheduling.stages import ActiveRun, StageState
from pipeline.scheduling.streams import Streams
from pipeline.scheduling.topology import OnError, Topology


class Runs(Streams):
    """The runs of one graph over its messages: where each is, and how each ends."""

    def __init__(self, topology: Topology, *, offline: bool, observer: Observer | None) -> None:
        super().__init__(topology, offline=offline, observer=observer)
        self._starts: list[Start] = []
        self._free_workers = topology.workers
        self._started = 0  #: runs, over all stages: the order of turns on devices
        self._state = 0  #: another number whenever another stage may come to want a device

    # ------------------------------------------------------------------ beginning

    def _start_run(self, stage: StageState, inputs: InputSet) -> None:
        assert stage.producer is not None
        stage.producer.book.delivered += 1
        run = ActiveRun(stage.node.name, stage.next_number, inputs, self._now)
        stage.next_number += 1
        self._state += 1
        stage.runs.append(run)
        stage.book.started += 1
        stage.last_started = self._started
        stage.last_stamp = run.stamp
        self._started += 1
        if inputs.marks:
            stage.book.mark(inputs.marks)
        self._observer.set_formed(stage.node.name, inputs, self._now)
        if stage.sync is not None:
            stage.sync.lower(stage.least_set())
        if (device := stage.device) is not None:
            run.device = device.name
            device.pending.append(run)
        self._start_step(stage, run, Step.PREPARE if device else Step.PROCESS)
        if stage.free or stage.sync is not None:
            self._mark(stage)

    def _start_step(self, stage: StageState, run: ActiveRun, step: Step) -> None:
        run.step, run.step_started = step, self._now
        inline = stage.inline and step is not Step.INFER
        if step is not Step.INFER:
            stage.cpu_steps += 1
            self._free_workers -= not inline
        self._starts.append(Start(run, step, inline))

    def _step_over(
        self, run: Run, *, failed: bool = False
    ) -> tuple[ActiveRun | None, StageState, Step | None]:
        """Free what the step held; the run is None where nobody waits for it any more."""
        assert isinstance(run, ActiveRun)
        stage = self._by_name[run.stage]
        step, run.step = run.step, None
        if step is Step.INFER:
            device = self._devices[str(run.device)]
            if device.inferring is run:
                device.end(run, self._now, failed=failed)
        else:
            stage.cpu_steps -= 1
            if not stage.inline:
                self._free_workers += 1
        known = run.ended is None and run in stage.runs
        return (run if known else None), stage, step

    # ------------------------------------------------------------------ devices

    def _serve(self, device: Device) -> None:
        """Start the next infer of an idle device whose next run is prepared."""
        while device.up and device.inferring is None and device.pending:
            run = self._next_prepared(device)
            if run is None:
                return
            device.pending.remove(run)
            stage = self._by_name[run.stage]
            age = stage.max_age
            if age is not None and not self._offline and self._now - run.stamp > age:
                self._end(stage, run, "abandoned")
                self._mark(stage)
                continue
            device.begin(run, None if self._offline else stage.node.timeout, self._now)
            self._start_step(stage, run, Step.INFER)
        device.wakeup = None
        self._mark_device(device)

    def _serve_next(self, run: Run, step: Step | None) -> None:
        """An infer is over, and so is what it did to its stage: the device goes on."""
        if step is Step.INFER:
            self._serve(self._devices[str(run.device)])

    def _next_prepared(self, device: Device) -> ActiveRun | None:
        """The prepared run to infer; there is more than one only after another device died."""
        prepared = [run for run in device.pending if run.prepared and not run.doomed]
        if len(prepared) < 2:
            return prepared[0] if prepared else None
        stage_of = self._by_name
        return min(
            prepared,
            key=lambda r: (-stage_of[r.stage].priority, r.stamp, stage_of[r.stage].index),
        )

    def _hung(self, device: Device) -> None:
        assert device.inferring is not None
        text = f"an infer of {device.inferring.stage} does not return; its runs go on elsewhere"
        self._event("device_hung", device.name, text)
        self._lose(device, "abandoned")

    def _lose(self, lost: Device, how: str) -> None:
        """A device is gone. `how` the run that infers on it ends where it has no later rung."""
        if not lost.up:
            return
        moved = list(lost.pending)
        lost.pending.clear()
        if lost.inferring is not None:
            moved.insert(0, self._retire(lost.inferring))
        lost.lose(self._now)
        self._event("device_down", lost.name, _goes_on(lost))
        for run in moved:
            self._move(run, lost, how if run is moved[0] else "abandoned")
        for other in self._devices.values():
            self._serve(other)
        for stage in lost.stages:
            if not stage.live and stage.group and not stage.stopped:
                self._drop_queue(stage, Reason.REPLACED)
        self._mark_device(lost)

    def _restore(self, device: Device) -> None:
        device.restore(self._now)
        self._event("device_up", device.name, "works again; its stages climb back")
        self._mark_device(device)
        self._mark_wanted()  # they make room where they were

    def _later_rung(self, run: ActiveRun, lost: Device) -> Device | None:
        ladder = self._by_name[run.stage].ladder
        return next((rung for rung in ladder[ladder.index(lost) + 1 :] if rung.up), None)

    def _move(self, run: ActiveRun, lost: Device, how: str) -> None:
        """Take a run whose device is gone to the next rung of its ladder that is up."""
        device = None if run.doomed else self._later_rung(run, lost)
        if device is None:
            if run.step is None:
                self._end(self._by_name[run.stage], run, "abandoned" if run.doomed else how)
            else:
                run.doomed = True
            return
        run.device = device.name
        device.pending.append(run)

    def _retire(self, run: ActiveRun) -> ActiveRun:
        """A fresh run in place of one whose infer is lost: what comes of the old one is ignored."""
        stage = self._by_name[run.stage]
        fresh = ActiveRun(run.stage, run.number, run.inputs, run.started)
        fresh.result, fresh.prepared, fresh.prepared_at = run.result, True, self._now
        fresh.doomed = run.doomed
        stage.runs[stage.runs.index(run)] = fresh
        return fresh

    def _mark_device(self, device: Device) -> None:
        for stage in device.stages:
            self._mark(stage)
            if stage.group is not None:
                for member in stage.group.members:
                    self._mark(member)

    # ------------------------------------------------------------------ ending

    def _finish(self, stage: StageState, run: ActiveRun, outputs: Sequence[Output]) -> None:
        run.outputs = outputs
        self._end(stage, run, "finished" if outputs or not stage.ports else "filtered")

    def _end(self, stage: StageState, run: ActiveRun, how: str) -> None:
        """A run is over; it leaves when every earlier one has."""
        run.ended = how
        device = self._devices.get(str(run.device))
        if device is not None and run in device.pending:
            device.pending.remove(run)
            self._serve(device)
        if stage.runs[0] is run:
            self._commit(stage)

    def _commit(self, stage: StageState) -> None:
        """Let runs leave in trigger order: publish what they say, enter how they ended."""
        while stage.runs and (how := stage.runs[0].ended) is not None:
            run = stage.runs[0]
            if how == "finished" and not self._say(stage, run):
                how = "failed"
            stage.runs.popleft()
            stage.book.end(how)
            self._observer.run_ended(run, how, self._now)
            self._outputs_changed(stage)
            if how == "failed" and stage.node.on_error is OnError.STOP and not stage.stopped:
                self._stop_stage(stage)

    def _say(self, stage: StageState, run: ActiveRun) -> bool:
        """Publish a run's outputs; False where a port does not take its stamp."""
        if not run.outputs:
            return True
        trigger = run.inputs.trigger
        lineage, degraded = _lineage(run.inputs)
        if stage.ladder and run.device != stage.ladder[0].name:
            degraded = True
        messages: list[tuple[OutputPort, Message[Any]]] = []
        for output in run.outputs:
            port = stage.ports[output.port]
            stamp, begin, end = _when(output, trigger)
            message = Message(
                output.payload,
                stamp,
                begin,
                end,
                self._now,
                port.published,
                lineage,
                run.device,
                degraded,
            )
            reason = port.refusal(message)
            if reason is None and stamp < trigger.stamp:
                reason = Refusal.BACKWARD
            if reason is not None:
                text = f"a result at stamp {stamp} for a trigger at {trigger.stamp} is {reason}"
                self._event("bad_output", str(port.port), text)
                return False
            messages.append((port, message))
        for port, message in messages:
            self._send(port, message)
        return True

    def _stop_stage(self, stage: StageState) -> None:
        """A stage is out for good: what it holds ends, its streams end, the graph goes on."""
        stage.stopped = True
        stage.stand()
        self._drop_slots(stage, Reason.STAGE_STOPPED)
        self._drop_triggers(stage, Reason.STAGE_STOPPED)
        for run in stage.runs:
            run.doomed = True
            if run.ended in ("finished", "filtered"):  # waits for an earlier one: never to be said
                run.ended = "abandoned"
        for run in list(stage.finishing):
            self._end(stage, run, "abandoned")
        stage.finishing.clear()
        for device in stage.ladder:
            for run in [r for r in device.pending if r.stage == stage.node.name and r.prepared]:
                self._end(stage, run, "abandoned")
        text = "a run failed and on_error is stop; the rest of the graph goes on without it"
        self._event("stage_stopped", stage.node.name, text)
        for port in stage.ports:
            self._raise(port, INFINITY)
        if stage.group is not None:
            for member in stage.group.members:
                self._mark(member)


def _goes_on(lost: Device) -> str:
    """What becomes of the stages of a lost device, for people."""
    fates: dict[str, list[str]] = {}
    for stage in lost.stages:
        fate = f"{stage.device.name} takes over" if stage.device else "nothing runs"
        fates.setdefault(fate, []).append(stage.node.name)
    return "is lost; " + ", ".join(f"{fate} {' '.join(names)}" for fate, names in fates.items())


def _when(output: Output, trigger: Message[Any]) -> tuple[int, int, int]:
    """Stamp, begin and end of a result: its own, or the trigger's where it has none."""
    if output.stamp is None:
        return trigger.stamp, trigger.begin, trigger.end
    begin = output.stamp if output.begin is None else output.begin
    end = output.stamp if output.end is None else output.end
    return output.stamp, begin, end


def _lineage(inputs: InputSet) -> tuple[tuple[Sample, ...], bool]:
    """The union of the lineages of a set, in the order of the set; whether one is degraded."""
    if len(inputs.values) == 1:
        return inputs.trigger.lineage, inputs.trigger.degraded
    samples: dict[Sample, None] = {}
    degraded = False
    for value in inputs.values:
        messages = value if isinstance(value, tuple) else (value,)
        for message in messages:
            if isinstance(message, tuple):  # a span on a port of several edges
                for one in message:
                    samples.update(dict.fromkeys(one.lineage))
                    degraded |= one.degraded
            elif message is not None:
                samples.update(dict.fromkeys(message.lineage))
                degraded |= message.degraded
    return tuple(samples), degraded
