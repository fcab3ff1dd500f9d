"""The other process of the transport's benchmark: receives on every side, reports when asked.

`python -m tools.bench.transport_peer ENDPOINT RAW_ENDPOINT SOCKET`. A line `SIDE COUNT` on its
standard input is answered with a line of JSON, the latencies in us, as soon as that many messages
came or none came for a while.
"""

from __future__ import annotations

import json
import queue
import sys
import threading
import time
from collections import defaultdict
from functools import partial
from typing import Any

import numpy as np
import zmq

from pipeline.transport.channel import Arrival, Channel
from pipeline.transport.envelope import Kind
from pipeline.transport.schema import PayloadSchema
from pipeline.transport.zenoh import Link, LinkOptions, open_session
from stages.types import Image

#: Shapes of the payloads by what they are called; 8 B travel as bytes.
SHAPES = {"1.2 MB": (640, 640, 3), "4.2 MB": (1000, 1400, 3)}
SIZES = ("8 B", *SHAPES)
SCHEMA = PayloadSchema.of([Image])
STAMP_BYTES = 8  #: the sender's clock, before each payload of the bare sides
SILENCE_S = 2.0


def channel(size: str) -> Channel:
    """Ours, for payloads of a size."""
    name = size.replace(" ", "")
    return Channel(f"bench/{name}", f"bench/{name}", SCHEMA)


def raw_key(size: str) -> str:
    """Bare Zenoh's."""
    return f"raw/{size.replace(' ', '')}"


class Arrivals:
    """Latencies by side, noted on whatever thread they come."""

    def __init__(self) -> None:
        self._noted: dict[str, queue.SimpleQueue[float]] = defaultdict(queue.SimpleQueue)

    def note(self, side: str, sent_ns: int) -> None:
        self._noted[side].put((time.monotonic_ns() - sent_ns) / 1e3)

    def ours(self, size: str, arrival: Arrival) -> None:
        if arrival.envelope.kind is Kind.MESSAGE:
            assert arrival.payload is not None
            self.note(f"ours {size}", arrival.envelope.stamp)

    def read(self, size: str, arrival: Arrival) -> None:
        """Ours, and every byte looked at."""
        if arrival.envelope.kind is Kind.MESSAGE:
            look(arrival.payload.data)
            self.note(f"read {size}", arrival.envelope.stamp)

    def raw(self, size: str, sample: Any) -> None:
        data = sample.payload.to_bytes()
        self.note(f"zenoh {size}", stamp_of(data))

    def raw_read(self, size: str, sample: Any) -> None:
        data = sample.payload.to_bytes()
        look(np.frombuffer(data, np.uint8))
        self.note(f"zenoh read {size}", stamp_of(data))

    def zmq(self, socket: zmq.Socket[bytes]) -> None:
        while True:
            side, data = socket.recv_multipart()
            self.note(side.decode(), stamp_of(data))

    def of(self, side: str, count: int) -> list[float]:
        """The next `count` latencies of a side, or as many as come."""
        latencies: list[float] = []
        while len(latencies) < count:
            try:
                latencies.append(self._noted[side].get(timeout=SILENCE_S))
            except queue.Empty:
                break
        return latencies


def look(data: np.ndarray[Any, Any]) -> int:
    """Read every byte."""
    return int(np.bitwise_or.reduce(data.reshape(-1)[: data.size // 8 * 8].view(np.uint64)))


def stamp_of(data: bytes) -> int:
    """When it was sent, ns."""
    return int.from_bytes(data[:STAMP_BYTES], "little")


def main(endpoint: str, raw_endpoint: str, path: str) -> None:
    """Receive until standard input ends."""
    arrivals = Arrivals()
    socket = zmq.Context().socket(zmq.PULL)
    socket.bind(path)
    threading.Thread(target=arrivals.zmq, args=(socket,), daemon=True).start()
    session = open_session(LinkOptions(connect=[raw_endpoint]))
    with Link(LinkOptions(connect=[endpoint], run="bench")) as link:
        for size in SIZES:
            link.subscribe(channel(size), partial(arrivals.ours, size))
            session.declare_subscriber(raw_key(size), partial(arrivals.raw, size))
            if size in SHAPES:
                link.subscribe(channel(f"read {size}"), partial(arrivals.read, size))
                session.declare_subscriber(
                    raw_key(f"read {size}"), partial(arrivals.raw_read, size)
                )
        answer("ready")
        for line in sys.stdin:
            side, count = line.strip().rsplit(" ", 1)
            if side == "cpu":
                answer(time.process_time_ns())
            else:
                answer(arrivals.of(side, int(count)))
    session.close()  # type: ignore[no-untyped-call]


def answer(value: Any) -> None:
    """Write a line of JSON."""
    sys.stdout.write(json.dumps(value) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
