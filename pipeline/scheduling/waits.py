"""What a trigger waits for: asked of the scheduler by those who explain a run, never by itself."""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from typing import Any, NamedTuple

from pipeline.message import Message
from pipeline.scheduling.stages import StageState


class Cause(StrEnum):
    """Why a trigger that has arrived has not started a run yet."""

    INPUT = "input"  #: its set waits for another input
    EARLIER = "earlier"  #: an earlier trigger is served first
    RUNNING = "running"  #: as many runs as the stage may have are not over
    NO_ROOM = "no_room"  #: an output with `policy: block` is full
    DEVICE_DOWN = "device_down"  #: no device of its ladder is up
    DEVICE_BUSY = "device_busy"  #: its device works, and has its next run
    TURN = "turn"  #: another stage has the turn on its device, or it is too early to prepare
    WORKER = "worker"  #: no CPU worker is free


class Wait(NamedTuple):
    """One trigger that waits."""

    message: Message[Any]
    cause: Cause
    edge: str = ""  #: the edge that an `input` wait is for


def waits_of(stage: StageState, *, blocked: bool, workers: int) -> Iterator[Wait]:
    """Every trigger that a stage holds and has not started, the next one first.

    `blocked`: an output has no room; `workers`: how many CPU workers are free.
    """
    sets = list(stage.sync.waiting) if stage.sync is not None else []
    entries = [*sets, *stage.queue.entries]
    if (undecided := stage.undecided()) is not None:
        entries.append(undecided)
    for place, entry in enumerate(entries):
        if place:
            yield Wait(entry.message, Cause.EARLIER)
        elif sets and (edge := _blocking_edge(stage)):
            yield Wait(entry.message, Cause.INPUT, edge)
        else:
            yield Wait(entry.message, _cause(stage, blocked, workers))


def _blocking_edge(stage: StageState) -> str:
    slot = stage.sync.blocker if stage.sync is not None else None
    return next((edge.name for edge in stage.synced_edges if edge.slot is slot), "")


def _cause(stage: StageState, blocked: bool, workers: int) -> Cause:
    if not stage.free or (stage.cpu_steps and not stage.stateless):
        return Cause.RUNNING
    if blocked:
        return Cause.NO_ROOM
    if stage.ladder:
        device = stage.device
        if device is None:
            return Cause.DEVICE_DOWN
        if device.pending:
            return Cause.DEVICE_BUSY
    if workers or stage.inline:
        return Cause.TURN
    return Cause.WORKER
