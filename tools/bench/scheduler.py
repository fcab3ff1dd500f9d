"""Whole scheduler: events a second over the emulated graph of the paper, in virtual time.

An event is a message of a source, a step that ends, or a wake-up; its books, bounds and sets are in
it, and so is the small heap that stands for the driver. Devices take the times that the graph file
declares, and no time at all is slept. The interpreter is set as the live driver sets it.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import count, takewhile
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import graphs
from accelerators.registry import Registry
from pipeline.graph.graph import Graph, load_graph
from pipeline.measuring.statistics import Statistics
from pipeline.message import Message
from pipeline.scheduling.events import Output, Start, Step
from pipeline.scheduling.ledger import balanced
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Port, Topology
from pipeline.stage import Source
from tools.bench.harness import Effort, Row, interleave, live_settings, ratio

FILE = Path(graphs.__file__).parent / "emulated_uav.yaml"
GOAL_HZ = 40_000
#: What steps on the CPU are taken to cost, about as `emulated` measures them: those of stages with
#: a network, and whole runs of the others.
PREPARE_MS = FINISH_MS = 1.0
PROCESS_MS = {"fuse_image": 21.0, "fuse_cloud": 12.0, "semantic_map": 8.0}

Durations = Mapping[tuple[str, Step], int]  #: ns, by stage and step
Arrivals = Sequence[tuple[int, Port, Message[Any]]]  #: (arrival, port, message), by arrival


def measure(effort: Effort) -> list[Row]:
    """The rows: with the books alone, and with a run's statistics."""
    seconds, rounds = effort.of(60, 2), effort.of(9, 2)
    graph = load_graph(FILE, catalog=Registry.open())
    messages, steps = arrivals(graph, seconds), durations(graph)

    def events_hz(*, observed: bool) -> float:
        observer = Statistics(offline=False) if observed else None
        scheduler = Scheduler(graph.topology, observer=observer)
        with live_settings():
            started = perf_counter()
            events = drive(scheduler, graph.topology, messages, steps)
            rate = events / (perf_counter() - started)
        if not balanced(scheduler.ledger()):
            raise RuntimeError("the ledger does not balance; the measurement says nothing")
        return rate

    rates = interleave(
        {
            "books": partial(events_hz, observed=False),
            "statistics": partial(events_hz, observed=True),
        },
        rounds,
    )
    books, statistics = (median(each) for each in rates.values())
    return [
        Row(
            "whole scheduler, emulated graph, with its books",
            f">= {GOAL_HZ:,} events/s",
            f"{books:,.0f} events/s",
            met=books >= GOAL_HZ,
            values={"events_hz": books},
        ),
        Row(
            "the same with the statistics of a run",
            "",
            f"{statistics:,.0f} events/s",
            f"without: {books:,.0f} events/s",
            str(ratio(rates["statistics"], rates["books"])),
            values={"events_hz": statistics},
        ),
    ]


def arrivals(graph: Graph, seconds: float) -> Arrivals:
    """What the graph's own sources send, by arrival."""
    end = int(seconds * 1e9)
    found: list[tuple[int, Port, Message[Any]]] = []
    for planned in graph.stages:
        stage = planned.make()
        if isinstance(stage, Source):
            stage.open()
            stream = takewhile(lambda message: message.received < end, stage.messages())
            found += [(message.received, Port(planned.name), message) for message in stream]
            stage.close()
    return sorted(found, key=lambda arrival: arrival[0])


def durations(graph: Graph) -> Durations:
    """How long each step takes: on a device as the file declares it."""
    found: dict[tuple[str, Step], float] = {}
    for stage in graph.stages:
        found[stage.name, Step.PROCESS] = PROCESS_MS.get(stage.name, 0.0)
        if stage.model is not None:
            latency_ms = graph.devices[stage.ladder[0]].options["latency_ms"][stage.model]
            found[stage.name, Step.PREPARE] = PREPARE_MS
            found[stage.name, Step.INFER] = latency_ms
            found[stage.name, Step.FINISH] = FINISH_MS
    return {key: int(ms * 1e6) for key, ms in found.items()}


def drive(scheduler: Scheduler, topology: Topology, messages: Arrivals, steps: Durations) -> int:
    """Bring every event at its virtual instant; returns how many there were."""
    outputs = {
        node.name: tuple(Output(port, None) for port in range(len(node.outputs)))
        for node in topology.stages
    }
    order = count()
    ending: list[tuple[int, int, Start]] = []  #: running steps by their end

    def begin(starts: list[Start], now: int) -> None:
        for start in starts:
            end = now + steps[start.run.stage, start.step]
            heapq.heappush(ending, (end, next(order), start))

    events = 0
    for arrival, port, message in messages:
        for now, start in _before(arrival, ending, scheduler):
            events += 1
            if start is None:
                actions = scheduler.time(now)
                begin([action for action in actions if isinstance(action, Start)], now)
            else:
                last = start.step in (Step.PROCESS, Step.FINISH)
                said = outputs[start.run.stage] if last else None
                begin(scheduler.step_done(start.run, now, said), now)
        events += 1
        begin(scheduler.publish(port, message, arrival), arrival)
    return events


def _before(
    instant: int, ending: list[tuple[int, int, Start]], scheduler: Scheduler
) -> Iterator[tuple[int, Start | None]]:
    """Step ends, and wake-ups (None), that come no later than `instant`, in their order."""
    while True:
        end = ending[0][0] if ending else instant + 1
        wakeup = scheduler.next_wakeup()
        if wakeup is not None and wakeup <= min(end, instant):
            yield wakeup, None
        elif end <= instant:
            yield end, heapq.heappop(ending)[2]
        else:
            return
