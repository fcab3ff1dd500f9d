"""Chain of 10 inline stages: latency per hop at one message every 4 ms, and saturated throughput.

Latency is from the instant before the source publishes to the start of the tenth `process`, over
ten. The peer is a chain of ten asyncio tasks with an `asyncio.Queue` before each, paced alike.
Saturated, the source waits for nothing. asyncio then moves whole batches through queues that hold
many, which costs it the age of each message, so that it is shown with queues of 1 and of 64.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from statistics import median
from time import monotonic, perf_counter_ns
from typing import Any

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
    ratio,
)
from tools.bench.hop import PERIOD_S, Arrive, since
from tools.bench.live import reads, run_live

STAGES = 10
GOAL_HZ = 6000
BATCH = 64  #: messages that an asyncio queue holds; more gains a tenth


class Forward(Stage):
    """Hands its payload on."""

    inline = True

    def process(self, x: Message[Any]) -> Any:
        return x.payload


class ArriveInline(Arrive):
    """The end of the chain, on the thread that brings the message."""

    inline = True


def measure(effort: Effort) -> list[Row]:
    """The rows: latency idle and beside busy Python, and throughput."""
    count, rounds = effort.of(320, 40), effort.of(9, 2)
    many = effort.of(6000, 300)
    latencies: dict[str, Callable[[], list[float]]] = {}
    for load, busy in {"idle": False, "beside Python": True}.items():
        latencies[load] = partial(ours, count, PERIOD_S, busy=busy)
        latencies[f"{load}, peer"] = partial(asyncio_chain, count, PERIOD_S, busy=busy)
    measured = interleave(latencies, rounds)
    rates = interleave(
        {
            "ours": partial(ours_hz, many),
            "asyncio_one": partial(asyncio_hz, many, 1),
            "asyncio_batch": partial(asyncio_hz, many, BATCH),
        },
        rounds,
    )
    rate, one, batch = (median(each) for each in rates.values())
    return [
        *(
            latency_row(
                f"chain of {STAGES} inline stages, per hop, {load}",
                Latency(measured[load]),
                Latency(measured[f"{load}, peer"]),
                "asyncio",
                p50=1.5,
                hold=load == "idle",
            )
            for load in ("idle", "beside Python")
        ),
        Row(
            f"chain of {STAGES} inline stages, saturated",
            f">= {GOAL_HZ:,} messages/s",
            f"{rate:,.0f} messages/s",
            f"asyncio: {one:,.0f} with queues of 1, {batch:,.0f} of {BATCH}",
            str(ratio(rates["ours"], rates["asyncio_one"])),
            rate >= GOAL_HZ,
            {name: median(each) for name, each in rates.items()},
        ),
    ]


def run_chain(count: int, period_s: float) -> tuple[list[int], list[int]]:
    """When each message was published and when it reached the last stage, ns."""
    sent: list[int] = []
    end = ArriveInline()

    def messages() -> Iterator[Message[Any]]:
        for beat in paced(count, period_s):
            sent.append(perf_counter_ns())
            yield Message.at(beat, beat)

    names = [f"stage_{number}" for number in range(STAGES)]
    origins = ["source", *names]
    nodes = [StageNode("source")]
    for name, origin in zip(names, origins, strict=False):
        outputs = () if name == names[-1] else ("out",)
        nodes.append(StageNode(name, reads(origin, count), outputs, inline=True))
    stages: dict[str, Stage] = {name: Forward() for name in names[:-1]}
    run_live(nodes, {**stages, names[-1]: end}, {"source": messages()})
    return sent, end.at


async def run_asyncio(count: int, period_s: float, size: int) -> tuple[list[int], list[int]]:
    """The same of a chain of tasks."""
    sent: list[int] = []
    at: list[int] = []
    queues: list[asyncio.Queue[Any]] = [asyncio.Queue(size) for _ in range(STAGES)]

    async def source() -> None:
        start = monotonic()
        for beat in range(count):
            while (wait := start + beat * period_s - monotonic()) > 0:
                await asyncio.sleep(wait)
            sent.append(perf_counter_ns())
            await queues[0].put(beat)

    async def forward(here: asyncio.Queue[Any], there: asyncio.Queue[Any]) -> None:
        for _ in range(count):
            await there.put(await here.get())

    async def arrive(here: asyncio.Queue[Any]) -> None:
        for _ in range(count):
            await here.get()
            at.append(perf_counter_ns())

    hops = (forward(here, there) for here, there in pairwise(queues))
    await asyncio.gather(source(), *hops, arrive(queues[-1]))
    return sent, at


def ours(count: int, period_s: float, *, busy: bool) -> list[float]:
    """Latencies per hop of inline stages, us."""
    with busy_python(busy):
        return per_hop(*run_chain(count, period_s))


def asyncio_chain(count: int, period_s: float, *, busy: bool) -> list[float]:
    """Latencies per hop of tasks, us."""
    with live_settings(), busy_python(busy):
        return per_hop(*asyncio.run(run_asyncio(count, period_s, 1)))


def ours_hz(count: int) -> float:
    """Saturated throughput of inline stages."""
    return throughput(*run_chain(count, 0.0))


def asyncio_hz(count: int, size: int) -> float:
    """Saturated throughput of tasks with queues of `size`."""
    with live_settings():
        return throughput(*asyncio.run(run_asyncio(count, 0.0, size)))


def per_hop(sent: list[int], at: list[int]) -> list[float]:
    """Latencies through the chain, shared out over its stages, us."""
    return [each / STAGES for each in since(sent, at)]


def throughput(sent: list[int], at: list[int]) -> float:
    """Messages a second from the first publication to the last arrival."""
    return len(at) * 1e9 / (at[-1] - sent[0])
