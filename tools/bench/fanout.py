"""Fan-out of one 1.2 MB frame to 8 stages: by reference, read-only, and the time per delivery.

The time is from the instant before the source publishes to the start of the last of the eight
`process` calls, over eight. The floor is a bare thread that puts the frame eight times into one
`queue.Queue` for as many bare threads as there are workers.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import partial
from queue import Queue
from time import perf_counter_ns

import numpy as np
from numpy.typing import NDArray

from pipeline.message import Message
from pipeline.scheduling.topology import StageNode, Topology
from pipeline.stage import Stage
from stages.types import Image
from tools.bench.harness import (
    Effort,
    Latency,
    Row,
    interleave,
    latency_row,
    live_settings,
    paced,
)
from tools.bench.hop import PERIOD_S, since
from tools.bench.live import reads, run_live

READERS = 8
SHAPE = (640, 640, 3)


class Look(Stage):
    """Notes when a frame came, whether it is the very one, and whether it could be written to."""

    def __init__(self, sent: NDArray[np.uint8]) -> None:
        self.at: list[int] = []
        self.copies = 0
        self.read_only = True
        self._sent = sent

    def process(self, x: Message[Image]) -> None:
        self.at.append(perf_counter_ns())
        data = x.payload.data
        self.copies += not np.shares_memory(data, self._sent)
        self.read_only &= not data.flags.writeable


def measure(effort: Effort) -> list[Row]:
    """The rows: what the stages saw, and the time per delivery."""
    count, rounds = effort.of(200, 30), effort.of(9, 2)
    frame = np.zeros(SHAPE, np.uint8)
    looks: list[Look] = []
    measured = interleave(
        {"ours": partial(ours, frame, count, looks), "floor": partial(floor, frame, count)}, rounds
    )
    copies = sum(look.copies for look in looks)
    read_only = all(look.read_only for look in looks)
    size_mb = frame.nbytes / 1e6
    return [
        Row(
            f"fan-out of a {size_mb:.1f} MB frame to {READERS} stages",
            "no copy, read-only views",
            f"{copies} copies in {sum(len(look.at) for look in looks):,} deliveries, "
            + ("read-only" if read_only else "writable where the source left it so"),
            met=not copies and read_only,
            values={"copies": copies, "read_only": read_only},
        ),
        latency_row(
            f"fan-out of a {size_mb:.1f} MB frame, per delivery",
            Latency(measured["ours"]),
            Latency(measured["floor"]),
            "thread + queue",
            p50=1.5,
            hold=False,
        ),
    ]


def ours(frame: NDArray[np.uint8], count: int, looks: list[Look]) -> list[float]:
    """Time per delivery, us; `looks` gets the stages that saw the frames."""
    sent: list[int] = []

    def messages() -> Iterator[Message[Image]]:
        for beat in paced(count, PERIOD_S):
            image = Image(frame[:], "rgb")  # a fresh view, writable: the source protects nothing
            sent.append(perf_counter_ns())
            yield Message.at(beat, image)

    readers: dict[str, Stage] = {}
    nodes = [StageNode("source")]
    for number in range(READERS):
        look = Look(frame)
        looks.append(look)
        readers[f"reader_{number}"] = look
        nodes.append(StageNode(f"reader_{number}", reads("source", count), outputs=()))
    run_live(nodes, readers, {"source": messages()})
    last = [max(each) for each in zip(*(look.at for look in looks[-READERS:]), strict=True)]
    return [each / READERS for each in since(sent, last)]


def floor(frame: NDArray[np.uint8], count: int) -> list[float]:
    """The same of bare threads that share one queue."""
    channel: Queue[int | None] = Queue()
    sent: list[int] = []
    at: list[list[int]] = [[] for _ in range(count)]
    workers = Topology(()).workers

    def produce() -> None:
        for beat in paced(count, PERIOD_S):
            sent.append(perf_counter_ns())
            for _ in range(READERS):
                channel.put(beat)
        for _ in range(workers):
            channel.put(None)

    def consume() -> None:
        while (beat := channel.get()) is not None:
            at[beat].append(perf_counter_ns())

    threads = [threading.Thread(target=consume) for _ in range(workers)]
    threads.append(threading.Thread(target=produce))
    with live_settings():
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    return [each / READERS for each in since(sent, [max(times) for times in at])]
