"""Fan-out of a 1.2 MB frame to eight processes: frames a second, each of which all eight got.

`python -m tools.bench.transport_fanout ENDPOINT` is one of the eight: a byte on its standard output
for every `EVERY` frames.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from dataclasses import replace

import numpy as np

from pipeline.message import Message
from pipeline.transport.channel import Arrival
from pipeline.transport.envelope import Envelope, Kind
from pipeline.transport.zenoh import Link, LinkOptions, free_endpoint
from stages.types import Image
from tools.bench.harness import Effort, Row
from tools.bench.transport_peer import SHAPES, channel

READERS = 8
EVERY = 4
WINDOW = 12  #: frames that are on their way at most
GOAL = 864  #: frames/s of ezmsg on the machine where the goal was set
#: A reader that stands still finds its frames, and the news that repeat meanwhile, for 10 s.
CHANNEL = replace(channel("1.2 MB"), slots=16, depth=64)


def measure(effort: Effort) -> list[Row]:
    """The row."""
    frames = effort.of(2000, 60) // EVERY * EVERY
    rates = [rate(frames) for _ in range(effort.of(3, 1))]
    best = sorted(rates)[len(rates) // 2]
    return [
        Row(
            f"fan-out of a 1.2 MB frame to {READERS} processes",
            f">= {GOAL} frames/s",
            f"{best:.0f} frames/s, each to all {READERS}: {best * READERS:,.0f} deliveries/s",
            met=best >= GOAL,
            values={"frames_per_s": best, "deliveries_per_s": best * READERS},
        )
    ]


def rate(frames: int) -> float:
    """Frames a second of one run; raises RuntimeError where one is lost."""
    endpoint = free_endpoint()
    payload = Image(np.zeros(SHAPES["1.2 MB"], np.uint8), "rgb")
    with ExitStack() as stack:
        link = stack.enter_context(Link(LinkOptions(listen=[endpoint], run="bench")))
        link.advertise(CHANNEL)
        readers = [stack.enter_context(reader(endpoint)) for _ in range(READERS)]
        try:
            for each in readers:
                took(each)  # the news: it is there
            began = time.perf_counter()
            for number in range(frames):
                if number >= WINDOW and number % EVERY == 0:
                    for each in readers:
                        took(each)
                now = time.monotonic_ns()
                envelope = Envelope.of(Message.at(now, payload), CHANNEL.port, now + 1)
                link.publish(CHANNEL.key, envelope, payload)
            for _ in range(WINDOW // EVERY):
                for each in readers:
                    took(each)
            return frames / (time.perf_counter() - began)
        finally:
            for each in readers:
                each.kill()


def reader(endpoint: str) -> subprocess.Popen[bytes]:
    """One of the eight."""
    return subprocess.Popen(
        [sys.executable, "-m", "tools.bench.transport_fanout", endpoint],
        stdout=subprocess.PIPE,
        stdin=subprocess.PIPE,
        bufsize=0,
    )


def took(each: subprocess.Popen[bytes]) -> None:
    """Wait until it took some frames more."""
    assert each.stdout is not None
    if each.stdout.read(1) != b".":
        raise RuntimeError("a reader lost a frame, or ended")


def main(endpoint: str) -> None:
    """Receive until standard input ends, or a frame is lost."""
    lost = threading.Event()
    received = -1  # the first arrival is the news that the publisher is there

    def count(arrival: Arrival) -> None:
        nonlocal received
        if arrival.lost:
            lost.set()
        if arrival.envelope.kind is Kind.MESSAGE or received < 0:
            received += 1
            if received % EVERY == 0:
                os.write(1, b"x" if lost.is_set() else b".")

    with Link(LinkOptions(connect=[endpoint], run="bench")) as link:
        link.subscribe(CHANNEL, count)
        sys.stdin.read()


if __name__ == "__main__":
    main(*sys.argv[1:])
