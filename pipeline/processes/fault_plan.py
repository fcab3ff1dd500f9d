"""When the supervisor tells of a fault, and whom it kills."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator
from math import inf
from typing import NamedTuple

from pipeline.graph.faults import GraphFaults
from pipeline.scheduling.partition import Placement
from pipeline.transport.bad_wire import WireFaults


class PlannedFault(NamedTuple):
    """Something that goes wrong, or is right again."""

    at_s: float  #: of the graph's time
    subject: str  #: a process, or the port of a link
    text: str
    kills: bool = False


def planned_faults(
    faults: GraphFaults, placement: Placement, here: Collection[str]
) -> deque[PlannedFault]:
    """What happens to the processes `here` and to the links that begin there, in time."""
    plan = [
        PlannedFault(at_s, name, "is killed, as its faults say", kills=True)
        for name, times in faults.kills.items()
        if name in here
        for at_s in times
    ]
    for port, wire in faults.links.items():
        if placement.process_of[port.stage] in here:
            plan += (PlannedFault(at_s, str(port), text) for at_s, text in _turns(wire))
    return deque(sorted(plan))


def _turns(wire: WireFaults) -> Iterator[tuple[float, str]]:
    if wire.cut_at_s < inf:
        yield wire.cut_at_s, "its link is cut, as its faults say"
    if wire.restored_at_s < inf:
        yield wire.restored_at_s, "its link is restored"
    if wire.delay_s:
        yield 0.0, f"its link is slow by {wire.delay_s * 1e3:g} ms, as its faults say"
    if wire.drops:
        yield 0.0, f"its link loses {wire.drops:.1%} of the messages, as its faults say"
