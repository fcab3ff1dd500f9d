"""A run as it stands, for a line of progress."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median_low

from pipeline.graph.graph import Graph
from pipeline.measuring.statistics import Event, Statistics
from pipeline.measuring.status import LOSSES
from pipeline.scheduling.topology import Port


@dataclass(frozen=True, slots=True)
class OutputSnapshot:
    """One output port while the graph runs."""

    count: int
    rate_hz: float | None
    age_ms: float | None  #: median age of the oldest sample in it


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The run as it stands."""

    elapsed_s: float  #: of wall time
    outputs: Mapping[str, OutputSnapshot]
    dropped: int  #: messages lost, without those that no set needed and that rate_hz leaves out
    events: Sequence[Event]  #: everything that a person should know, so far; grows
    done: float | None = None  #: how far it has come, 0 to 1, where its end is known


def snapshot(graph: Graph, statistics: Statistics, elapsed_ns: int, done: float | None) -> Snapshot:
    """What the books of a run say after so long."""
    outputs: dict[str, OutputSnapshot] = {}
    for node in graph.topology.stages:
        for port in node.outputs:
            key = Port(node.name, port)
            known = statistics.ports.get(key)
            age = median_low(known.recent_ages) if known and known.recent_ages else None
            outputs[str(key)] = OutputSnapshot(
                known.count if known else 0,
                known.rate_hz() if known and not statistics.offline else None,
                None if age is None else age / 1e6,
            )
    return Snapshot(
        elapsed_ns / 1e9,
        outputs,
        sum(statistics.drops[reason] for reason in LOSSES),
        statistics.events,
        done,
    )
