"""In-process hop: from the instant before a source publishes to the start of `process` on a worker.

One message every 4 ms, by reference. The floor is a bare thread that puts into a `queue.Queue` and
a bare thread that gets, under the same pacing and with the interpreter set as the live driver sets
it (switch interval 0.5 ms, garbage collector frozen). `beside Python`: a third thread runs pure
Python all the time, on both sides.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from functools import partial
from queue import Queue
from time import perf_counter_ns
from typing import Any

import numpy as np

from pipeline.message import Message
from pipeline.scheduling.topology import StageNode
from pipeline.stage import Stage
from tools.bench.harness import (
    Effort,
    Latency,
    Row,
    busy_python,
    interleave,
    latency_row,
    live_settings,
    paced,
)
from tools.bench.live import reads, run_live

PERIOD_S = 0.004
WARM_UP = 20  #: messages before the first that counts


class Arrive(Stage):
    """Notes when each message reached a stage; its stamp is its number."""

    def __init__(self) -> None:
        self.at: list[int] = []

    def process(self, x: Message[Any]) -> None:
        self.at.append(perf_counter_ns())


def measure(effort: Effort) -> list[Row]:
    """The rows: both payloads, idle and beside busy Python."""
    count, rounds = effort.of(320, 40), effort.of(9, 2)
    payloads = {"64 B": bytes(64), "4 MB": np.zeros(4_000_000, np.uint8)}
    loads = {"idle": False, "beside Python": True}
    sides: dict[str, Callable[[], list[float]]] = {}
    for size, payload in payloads.items():
        for load, busy in loads.items():
            sides[f"{size}, {load}"] = partial(ours, payload, count, busy=busy)
            sides[f"{size}, {load}, floor"] = partial(floor, payload, count, busy=busy)
    measured = interleave(sides, rounds)
    return [
        latency_row(
            f"in-process hop, {name}",
            Latency(measured[name]),
            Latency(measured[f"{name}, floor"]),
            "thread + queue",
            p50=1.5,
            p99=3,
        )
        for name in (f"{size}, {load}" for size in payloads for load in loads)
    ]


def ours(payload: Any, count: int, *, busy: bool) -> list[float]:
    """Latencies of a source and a stage, us."""
    sent: list[int] = []
    arrive = Arrive()

    def messages() -> Iterator[Message[Any]]:
        for beat in paced(count, PERIOD_S):
            sent.append(perf_counter_ns())
            yield Message.at(beat, payload)

    nodes = [StageNode("source"), StageNode("sink", reads("source", count), outputs=())]
    with busy_python(busy):
        run_live(nodes, {"sink": arrive}, {"source": messages()})
    return since(sent, arrive.at)


def floor(payload: Any, count: int, *, busy: bool) -> list[float]:
    """Latencies of two bare threads and a queue, us."""
    channel: Queue[Any] = Queue()
    sent: list[int] = []
    at: list[int] = []

    def produce() -> None:
        for _ in paced(count, PERIOD_S):
            sent.append(perf_counter_ns())
            channel.put(payload)
        channel.put(None)

    def consume() -> None:
        while channel.get() is not None:
            at.append(perf_counter_ns())

    threads = [threading.Thread(target=consume), threading.Thread(target=produce)]
    with live_settings(), busy_python(busy):
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    return since(sent, at)


def since(sent: list[int], at: list[int]) -> list[float]:
    """Latencies after the warm-up, us."""
    each = [(b - a) / 1e3 for a, b in zip(sent, at, strict=True)]
    return each[min(WARM_UP, len(each) // 2) :]
