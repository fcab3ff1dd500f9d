"""What the sensors of a graph would send, in virtual time: stamps and arrivals without payloads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import count
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from pipeline.measuring.costs import SourceCost
from pipeline.message import Message
from pipeline.scheduling.topology import Port, StageNode, Sync, Topology

MS = 1_000_000  #: ns


def arrivals(
    topology: Topology, sources: Mapping[str, SourceCost], seconds: float, seed: int
) -> Iterator[tuple[int, Port, Message[None]]]:
    """(arrival in ns, port, message) of every source, by arrival; the same seed, the same streams.

    Sources that an `exact` input brings together are one sensor's: they share stamps. Clocks of
    sensors run free: where no phase is given, the first one is drawn, and each clock gains or loses
    another whole number of periods over the run, so that it meets the others in all phases alike.
    """
    clock_of = shared_clocks(topology)
    free = [name for name in dict.fromkeys(clock_of.values()) if sources[name].phase_ms is None]
    free.sort(key=lambda name: -sources[name].period_ms)  # to the fastest a period matters least
    slips = dict(zip(free, _slips(), strict=False))
    ports = [
        Port(node.name, output)
        for node in topology.stages
        if node.is_source
        for output in node.outputs
    ]
    stamps = [
        _stamps(sources[clock], seconds, slips.get(clock, 0), seed + crc32(clock.encode()))
        for clock in (clock_of[port.stage] for port in ports)
    ]
    if not ports:
        return
    extents = [round((sources[port.stage].extent_ms or 0.0) * MS) for port in ports]
    delays = [round(sources[port.stage].delay_ms * MS) for port in ports]
    arrived = np.concatenate([times + ns for times, ns in zip(stamps, delays, strict=True)])
    which = np.repeat(np.arange(len(ports)), [len(times) for times in stamps])
    order = np.argsort(arrived, kind="stable")
    columns = (arrived[order], which[order], np.concatenate(stamps)[order])
    for at, number, stamp in zip(*(column.tolist() for column in columns), strict=True):
        extent = extents[number]
        yield at, ports[number], Message(None, stamp, stamp - extent, stamp + extent, at)


def _slips() -> Iterator[int]:
    """0, 1, -1, 2, -2 ..."""
    yield 0
    for slip in count(1):
        yield from (slip, -slip)


def _stamps(source: SourceCost, seconds: float, slip: int, seed: int) -> NDArray[np.int64]:
    """ns; every stamp within `seconds`, none below 0."""
    random = np.random.default_rng(seed)
    fixed = source.phase_ms
    phase = random.uniform(0, source.period_ms) if fixed is None else fixed % source.period_ms
    periods = max(1.0, seconds * 1e3 / source.period_ms + slip)
    numbers = np.arange(int(periods) + 2)
    jitter = random.uniform(-source.jitter_ms, source.jitter_ms, len(numbers))
    stamps = phase + numbers * (seconds * 1e3 / periods) + jitter
    return np.rint(stamps[(stamps >= 0) & (stamps < seconds * 1e3)] * MS).astype(np.int64)


def shared_clocks(topology: Topology) -> dict[str, str]:
    """For every source the first of those whose stamps it shares."""
    nodes = {node.name: node for node in topology.stages}
    clock = {name: name for name, node in nodes.items() if node.is_source}
    for node in topology.stages:
        for entry in node.inputs:
            if entry.sync is Sync.EXACT:
                both = {clock[_origin(nodes, node)]}
                both |= {clock[_origin(nodes, nodes[edge.stage])] for edge in entry.sources}
                first = next(name for name in clock if clock[name] in both)
                clock = {name: first if own in both else own for name, own in clock.items()}
    return clock


def _origin(nodes: Mapping[str, StageNode], node: StageNode) -> str:
    """The source that a stage's stamps come from, along the triggers."""
    while not node.is_source:
        node = nodes[node.trigger.sources[0].stage]
    return node.name
