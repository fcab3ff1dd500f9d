"""Runs a hand-made topology live, as `run_graph` runs a file: for hop, chain and fan-out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pipeline.clock import ScaledClock
from pipeline.drivers.executor import Worker
from pipeline.drivers.live import LiveDriver
from pipeline.measuring.statistics import Statistics
from pipeline.message import Message
from pipeline.scheduling.ledger import balanced
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Input, Policy, Port, StageNode, Topology
from pipeline.stage import Stage


def reads(origin: str, size: int) -> tuple[Input]:
    """A trigger input `x` on `origin` that holds up to `size` messages: nothing is replaced, or a
    late message would leave the measurement instead of spoiling it."""
    return (Input("x", (Port(origin),), policy=Policy.DROP_OLDEST, size=size),)


class _NoDevices:
    """These topologies have none to lose."""

    def interrupt(self, name: str) -> None:
        raise LookupError(name)

    def check(self, name: str) -> None:
        raise LookupError(name)


def run_live(
    nodes: Sequence[StageNode],
    stages: Mapping[str, Stage],
    sources: Mapping[str, Iterator[Message[Any]]],
) -> None:
    """Run to the end of the sources; raises what a stage raised, and where a message was lost."""
    topology = Topology(tuple(nodes))
    statistics = Statistics(offline=False)
    scheduler = Scheduler(topology, observer=statistics)
    workers = {node.name: Worker(node, stages[node.name]) for node in nodes if node.inputs}
    failures: list[BaseException] = []

    def on_failure(stage: str, error: BaseException, text: str, stamp: int | None) -> None:
        failures.append(error)

    clock = ScaledClock(0)
    driver = LiveDriver(
        topology, scheduler, workers, dict(sources), clock, _NoDevices(), statistics, on_failure
    )
    driver.run(None, lambda: None)
    if failures:
        raise failures[0]
    ledger = scheduler.ledger()
    lost = sum(sum(page["dropped"].values()) for page in ledger.values())
    if lost or not balanced(ledger):
        raise RuntimeError(f"{lost} messages lost; the measurement says nothing")
