"""What the scheduler knows of a graph: stages, ports and edges as plain values, no classes, no
files."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple


class Sync(StrEnum):
    """How an input takes part in an input set."""

    TRIGGER = "trigger"
    EXACT = "exact"
    NEAREST = "nearest"
    LATEST = "latest"
    SPAN = "span"


class Missing(StrEnum):
    """What a set does without a candidate."""

    PROCEED = "proceed"
    HOLD = "hold"
    SKIP = "skip"


class Policy(StrEnum):
    """What a full trigger queue does."""

    LATEST = "latest"
    DROP_OLDEST = "drop_oldest"
    DROP_NEWEST = "drop_newest"
    BLOCK = "block"


class OnError(StrEnum):
    """What a failed run does to its stage."""

    STOP = "stop"
    SKIP = "skip"


class Role(StrEnum):
    """What a node of a topology stands for."""

    STAGE = "stage"  #: a stage of the file
    REMOTE = "remote"  #: a stage of another process: a source here, of what it sends
    SENDER = "sender"  #: takes the messages of a port to another process


class Port(NamedTuple):
    """An output port."""

    stage: str
    name: str = "out"

    def __str__(self) -> str:
        return f"{self.stage}/{self.name}"


@dataclass(frozen=True, slots=True)
class Input:
    """One input port of a stage with its rules; times in ns. Defaults are the file's."""

    name: str
    sources: tuple[Port, ...]  #: one edge each; more than one only where `many`
    sync: Sync = Sync.TRIGGER
    many: bool = False  #: the port takes a tuple, one entry per edge
    tolerance: int = 0  #: nearest: |stamp + offset - T| <= tolerance
    offset: int = 0  #: added to this input's stamps before they are compared with the trigger's
    max_wait: int | None = (
        None  #: from the trigger's arrival; None: exact only, twice the measured period
    )
    missing: Missing = Missing.SKIP
    hold: int = 0  #: missing: hold uses the last message with T - (stamp + offset) <= hold
    policy: Policy = Policy.LATEST  #: trigger only
    size: int = 1  #: trigger only
    max_age: int | None = (
        None  #: trigger only: now - stamp, checked before prepare and before infer
    )
    select: str | None = (
        None  #: trigger only: inputs of one output with the same select share frames
    )
    period: int | None = None  #: rate_hz: decimate the edge to this period
    compress: str | None = None  #: to another host: ``zstd``, or a class as ``module:Class``


@dataclass(frozen=True, slots=True)
class StageNode:
    """One stage as the scheduler sees it."""

    name: str
    inputs: tuple[Input, ...] = ()  #: in the order of the stage's signature; none for a source
    outputs: tuple[str, ...] = ("out",)  #: empty for a sink
    devices: tuple[str, ...] = ()  #: the ladder, first preferred; empty without a model
    max_in_flight: int = 1  #: runs started and unfinished; default 2 with a model
    priority: int = 0  #: higher first
    inline: bool = False
    stateless: bool = False
    on_error: OnError = OnError.STOP
    min_period: int | None = None  #: a source's promise, ns
    wanted: bool = False  #: run on the frames that somebody downstream will choose
    timeout: int | None = None  #: the longest infer, ns; None: by what was measured
    degraded_period: int | None = None  #: the least distance of stamps on a lower rung, ns
    role: Role = Role.STAGE

    @property
    def is_source(self) -> bool:
        return not self.inputs

    @property
    def trigger(self) -> Input:
        """The input whose messages start a run; raises LookupError for a source."""
        for candidate in self.inputs:
            if candidate.sync is Sync.TRIGGER:
                return candidate
        raise LookupError(f"{self.name} has no trigger")


@dataclass(frozen=True, slots=True)
class Topology:
    """A whole graph for the scheduler; `stages` in the order of the file, which breaks all ties."""

    stages: tuple[StageNode, ...]
    workers: int = 2  #: CPU workers: one more than cores
    check_every: int = 1_000_000_000  #: the first pause before a lost device is checked, ns

    def stage(self, name: str) -> StageNode:
        for stage in self.stages:
            if stage.name == name:
                return stage
        raise LookupError(name)
