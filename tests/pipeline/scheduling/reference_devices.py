"""The devices of the reference: which is up, when it will be free, and when one is given up or
checked (section 7 of pipeline/scheduling/README.md), from all that was ever measured."""

from __future__ import annotations

from math import inf
from statistics import median_high

from reference_streams import Job, Streams

from pipeline.scheduling.events import Check, Observer, Step
from pipeline.scheduling.topology import StageNode, Topology


class Devices(Streams):
    def __init__(
        self, topology: Topology, *, offline: bool = False, observer: Observer | None = None
    ) -> None:
        super().__init__(topology, offline=offline, observer=observer)
        self.devices = list(dict.fromkeys(d for node in self.nodes for d in node.devices))
        self.check_every = topology.check_every
        self.pause = dict.fromkeys(self.devices, self.check_every)
        self.came_up: dict[str, float] = dict.fromkeys(self.devices, -inf)
        self.check_due: dict[str, float] = {}  #: of devices that are down; inf: one is under way
        self.turns: list[str] = []  # the stage of every run, in the order of their starts
        self.took: list[tuple[str, Step, str | None, int]] = []  # measured step times

    # Up and down

    def _goes_down(self, device: str) -> None:
        self.down.add(device)
        doubled = min(2 * self.pause[device], 32 * self.check_every)
        stayed = self.now - self.came_up[device] >= 10 * self.pause[device]
        self.pause[device] = self.check_every if stayed else doubled
        self.check_due[device] = self.now + self.pause[device]
        self.observer.event("device_down", device, "", self.now)

    def _comes_up(self, device: str) -> None:
        self.down.remove(device)
        del self.check_due[device]
        self.came_up[device] = self.now
        self.observer.event("device_up", device, "", self.now)

    def _checks(self) -> list[Check]:
        due = [d for d in self.devices if self.check_due.get(d, inf) <= self.now]
        if self.stopping:
            return []
        self.check_due |= dict.fromkeys(due, inf)
        return [Check(device) for device in due]

    def _checked(self, device: str, ok: bool) -> None:
        if self.check_due.get(device) == inf:
            if ok:
                self._comes_up(device)
            else:
                self.check_due[device] = self.now + self.pause[device]

    def _hung(self) -> list[str]:
        return [device for device in self.devices if self._overdue_at(device) <= self.now]

    def _overdue_at(self, device: str) -> float:
        job = self._inferring(device)
        if job is None or self.offline:
            return inf
        timeout = self.node[job.run.stage].timeout
        if timeout is None:
            lasted = self._lasted(job.run.stage, Step.INFER, device)[-64:]
            timeout = max(10 * max(lasted), 100_000_000) if lasted else 10_000_000_000
        return job.since + timeout

    # Predictions

    def _lasted(self, stage: str, step: Step, device: str | None) -> list[int]:
        which = stage, step, device
        return [took for *measured, took in self.took if tuple(measured) == which]

    def _usual(self, stage: str, device: str | None) -> int:
        """The upper median of the stage's last eight infers on the device."""
        lasted = self._lasted(stage, Step.INFER, device)
        return median_high(lasted[-8:]) if lasted else 0

    def _free_at(self, device: str) -> int:
        job = self._inferring(device)
        return (
            self.now
            if job is None
            else max(self.now, job.since + self._usual(job.run.stage, device))
        )

    def _prepare_time(self, node: StageNode) -> int:
        lasted = [
            took for stage, step, _, took in self.took if (stage, step) == (node.name, Step.PREPARE)
        ]
        return max(lasted[-8:], default=0)

    def _in_time(self, node: StageNode) -> bool:
        device = self._device(node)
        assert device is not None
        return self.offline or self._free_at(device) - self._prepare_time(node) <= self.now

    def _last_turn(self, node: StageNode) -> int:
        return max((turn for turn, name in enumerate(self.turns) if name == node.name), default=-1)

    # Who is on a device

    def _device_lets(self, node: StageNode) -> bool:
        device = self._device(node)
        going = (job for job in self._all_in_flight() if job is not self._inferring(device))
        next_runs = [job for job in going if job.run.device == device and self._needs_device(job)]
        return device is not None and not next_runs

    def _needs_device(self, job: Job) -> bool:
        return job.step in (Step.PREPARE, Step.INFER) and not job.how and not job.doomed

    def _inferring(self, device: str | None) -> Job | None:
        going = (j for j in self._all_in_flight() if j.running and j.step is Step.INFER)
        return next((job for job in going if job.run.device == device), None)
