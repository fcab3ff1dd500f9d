"""A thousand kills: what stays behind when processes at either end of a channel are killed.

Publishers (with a ring full of frames) and subscribers (that hold frames) are killed in turn while
this process holds the other end. Long, so only on request: `python -m tools.bench transport_kills`.
"""

from __future__ import annotations

import multiprocessing
import sys
import threading
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess

import numpy as np
import psutil
import typer

from pipeline.message import Message
from pipeline.transport.channel import Arrival
from pipeline.transport.envelope import Envelope, Kind
from pipeline.transport.shared_files import FOLDER, PREFIX, sweep
from pipeline.transport.zenoh import Link, LinkOptions, free_endpoint
from stages.types import Image
from tools.bench.harness import Effort, Row, quantile
from tools.bench.transport_peer import SHAPES, channel

RUN = "kills"
CHANNEL = channel("1.2 MB")
PATIENCE_S = 20.0
#: Kills before the first reading: pools, caches and the allocator find their size.
WARM_UP = 100
#: Zenoh's runtime keeps idle threads for a while and starts others: a few come and go.
MOST_THREADS = 3
#: What a thousand kills may add: 0.5 KB each were seen, leveling off; leaked frames are 1,200 MB.
MOST_GROWTH_MB = 2.0


@dataclass(frozen=True, slots=True)
class Held:
    """What this process and the host hold."""

    anonymous_mb: float  #: resident, without mapped files: rings, which `shared_mb` shows
    descriptors: int
    threads: int
    shared_files: int
    shared_mb: float

    @classmethod
    def now(cls) -> Held:
        process = psutil.Process()
        memory = process.memory_info()
        files = list(FOLDER.glob(f"{PREFIX}{RUN}-*"))
        return cls(
            (memory.rss - memory.shared) / 1e6,
            process.num_fds(),
            process.num_threads(),
            len(files),
            sum(file.stat().st_size for file in files) / 1e6,
        )


def measure(effort: Effort) -> list[Row]:
    """The row."""
    kills = effort.of(1000, 10)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    sweep(RUN)
    rounds = (Publishers(context), Subscribers(context))
    try:
        for _ in range(min(WARM_UP, kills) // 2):
            for each in rounds:
                each.kill_one()
        before = Held.now()
        with typer.progressbar(range(kills // 2), label="kills / 2", file=sys.stderr) as progress:
            for _ in progress:
                for each in rounds:
                    each.kill_one()
        time.sleep(1.0)  # Zenoh notices the last death by itself
        after = Held.now()
    finally:
        for each in rounds:
            each.close()
    gaps = [gap for each in rounds for gap in each.gaps]
    grown = after.anonymous_mb - before.anonymous_mb
    same = (
        after.descriptors <= before.descriptors
        and after.shared_files <= before.shared_files
        and after.threads <= before.threads + MOST_THREADS
    )
    return [
        Row(
            f"{kills} kills of a peer, publishers and subscribers in turn",
            "no leak",
            f"memory {before.anonymous_mb:.1f} to {after.anonymous_mb:.1f} MB; "
            f"descriptors {before.descriptors} to {after.descriptors}; "
            f"threads {before.threads} to {after.threads}; "
            f"files in {FOLDER} {before.shared_files} to {after.shared_files} of "
            f"{after.shared_mb:.0f} MB; "
            f"heard again within p50 {quantile(gaps, 0.5):.2f}, p95 {quantile(gaps, 0.95):.2f} s "
            "of the start",
            met=same and grown < MOST_GROWTH_MB,
            values={
                "kills": kills,
                "memory_before_mb": before.anonymous_mb,
                "memory_after_mb": after.anonymous_mb,
                "gap_p95_s": quantile(gaps, 0.95),
            },
        )
    ]


class Round:
    """One end here, the other in a process that is killed; `gaps` are seconds from the start of a
    process to its fifth message."""

    def __init__(self, context: ForkServerContext) -> None:
        self._context = context
        self._endpoint = free_endpoint()
        self.gaps: list[float] = []

    def kill_one(self) -> None:
        """Start a process, wait until messages flow, kill it."""
        self.prepare()
        process = self.process()
        process.start()
        try:
            began = time.monotonic()
            if not self.flows(PATIENCE_S):
                raise RuntimeError(f"no message within {PATIENCE_S:g} s")
            self.gaps.append(time.monotonic() - began)
        finally:
            process.kill()
            process.join()
            process.close()
            sweep(RUN)  # as the supervisor does when a process has died

    def prepare(self) -> None: ...

    def process(self) -> BaseProcess:
        raise NotImplementedError

    def flows(self, timeout_s: float) -> bool:
        raise NotImplementedError

    def close(self) -> None:
        raise NotImplementedError


class Publishers(Round):
    """Publishers are killed while we hold their frames."""

    def __init__(self, context: ForkServerContext) -> None:
        super().__init__(context)
        self._flows = threading.Event()
        self._count = 0
        self._held: list[Image] = []
        self._link = Link(LinkOptions(connect=[self._endpoint], run=RUN))
        self._link.subscribe(CHANNEL, self._arrived)

    def _arrived(self, arrival: Arrival) -> None:
        if arrival.envelope.kind is Kind.MESSAGE:
            self._held = [*self._held[-2:], arrival.payload]
            self._count += 1
            if self._count == 5:
                self._flows.set()

    def prepare(self) -> None:
        self._count = 0
        self._flows.clear()

    def process(self) -> BaseProcess:
        return self._context.Process(target=publish, args=(self._endpoint,), daemon=True)

    def flows(self, timeout_s: float) -> bool:
        return self._flows.wait(timeout_s)

    def close(self) -> None:
        self._link.close()
        self._held.clear()


class Subscribers(Round):
    """Subscribers are killed while they hold our frames."""

    def __init__(self, context: ForkServerContext) -> None:
        super().__init__(context)
        self._over = threading.Event()
        self._ours, self._theirs = context.Pipe(duplex=False)
        self._link = Link(LinkOptions(listen=[self._endpoint], run=RUN))
        self._thread = threading.Thread(target=frames, args=(self._link, self._over), daemon=True)
        self._thread.start()

    def process(self) -> BaseProcess:
        return self._context.Process(
            target=subscribe, args=(self._endpoint, self._theirs), daemon=True
        )

    def flows(self, timeout_s: float) -> bool:
        return self._ours.poll(timeout_s) and bool(self._ours.recv_bytes())

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self._link.close()


def frames(link: Link, over: threading.Event) -> None:
    """Publish a frame every 10 ms."""
    payload = Image(np.zeros(SHAPES["1.2 MB"], np.uint8), "rgb")
    link.advertise(CHANNEL)
    while not over.wait(0.01):
        now = time.monotonic_ns()
        envelope = Envelope.of(Message.at(now, payload), CHANNEL.port, now + 1)
        link.publish(CHANNEL.key, envelope, payload)


def publish(endpoint: str) -> None:
    """A process that publishes until it is killed."""
    frames(Link(LinkOptions(listen=[endpoint], run=RUN)), threading.Event())


def subscribe(endpoint: str, told: Connection) -> None:
    """A process that holds frames until it is killed."""
    held: list[Image] = []

    def arrived(arrival: Arrival) -> None:
        if arrival.envelope.kind is Kind.MESSAGE:
            held.append(arrival.payload)
            if len(held) == 5:
                told.send_bytes(b".")
            del held[:-9]

    with Link(LinkOptions(connect=[endpoint], run=RUN)) as link:
        link.subscribe(CHANNEL, arrived)
        threading.Event().wait()
