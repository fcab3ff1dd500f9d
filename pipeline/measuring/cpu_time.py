"""The account of a run's CPU time: what each step of a stage cost, and the lines of the whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pipeline.measuring.quantiles import Quantiles

#: Values kept per stage, device and step.
KEPT = 4096


@dataclass(slots=True)
class StepCost:
    """All executions of one step of a stage on one device."""

    count: int = 0
    cpu_ns: int = 0  #: without the transfer
    transfer_ns: int = 0
    wall: Quantiles = field(default_factory=lambda: Quantiles(KEPT))  #: ns
    cpu: Quantiles = field(default_factory=lambda: Quantiles(KEPT))  #: ns, with the transfer


@dataclass(frozen=True, slots=True)
class CpuTime:
    """The CPU time of a run, ns, in lines that add up to `total`."""

    total: int  #: of this process and of those of its devices
    stages: Mapping[str, int]  #: sources too; with what their devices and own threads took
    shared: Mapping[str, int]  #: native threads that cannot be split among stages, by who uses them
    scheduler: int  #: its steps
    drivers: int  #: the framework's threads between steps: hand-overs, timers, reading clocks
    collector: int  #: Python's garbage collector
    progress: int  #: what shows the run while it goes on
    processes: Mapping[str, int]  #: of `total`: devices with a process of their own
    strangers: Mapping[str, int]  #: of what is unattributed: threads by name

    @property
    def unattributed(self) -> int:
        """What no line accounts for."""
        known = sum(self.stages.values()) + sum(self.shared.values())
        return self.total - known - self.scheduler - self.drivers - self.collector - self.progress
