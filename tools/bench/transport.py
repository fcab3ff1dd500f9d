"""Between two processes of one host: ours beside bare Zenoh and a ZeroMQ floor, interleaved.

The time is from the instant before `publish` until the subscriber has the payload. Ours hands out
arrays that lie where the writer put them, the others a copy; so `read` is the same with every byte
looked at before the time is taken. CPU is that of both processes together, at 30 Hz. Fan-out: eight
processes that look at nothing, at most `WINDOW` frames on their way.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from statistics import median
from typing import Any

import numpy as np
import zmq

from pipeline.message import Message
from pipeline.transport.envelope import Envelope
from pipeline.transport.zenoh import Link, LinkOptions, bare_publisher, free_endpoint, open_session
from stages.types import Image
from tools.bench import transport_fanout
from tools.bench.harness import Effort, Latency, Row, interleave, paced, ratio
from tools.bench.transport_peer import SHAPES, SIZES, channel, raw_key

PERIOD_S = 0.008
WARM_UP = 5  #: messages of each round that do not count
TRIES = 5
HZ = 30


def measure(effort: Effort) -> list[Row]:
    """The rows."""
    count, rounds = effort.of(45, 12), effort.of(11, 2)
    with sides() as (senders, peer):
        measured = interleave(
            {name: partial(latencies, peer, name, send, count) for name, send in senders.items()},
            rounds,
        )
        cpu = cpu_of(peer, senders["ours 1.2 MB"], "ours 1.2 MB", effort.of(8, 1))
    rows = [
        *(row(size, measured) for size in SIZES),
        *(read_row(size, measured) for size in SHAPES),
        cpu,
    ]
    return [*rows, *transport_fanout.measure(effort)]


class Peer:
    """The receiving process."""

    def __init__(self, words: Sequence[str]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.answer() == "ready"

    def ask(self, side: str, count: int = 0) -> Any:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{side} {count}\n")
        self._process.stdin.flush()
        return self.answer()

    def answer(self) -> Any:
        assert self._process.stdout is not None
        return json.loads(self._process.stdout.readline())

    def close(self) -> None:
        with self._process as process:
            assert process.stdin is not None
            process.stdin.close()
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:
                process.kill()


Send = Callable[[], None]


@contextmanager
def sides() -> Iterator[tuple[dict[str, Send], Peer]]:
    """What sends one message on each side, and who receives them."""
    endpoint, raw_endpoint = free_endpoint(), free_endpoint()
    with tempfile.TemporaryDirectory() as folder:
        path = f"ipc://{folder}/zmq"
        context = zmq.Context()
        socket = context.socket(zmq.PUSH)
        session = open_session(LinkOptions(listen=[raw_endpoint]))
        with Link(LinkOptions(listen=[endpoint], run="bench")) as link:
            peer = Peer(["tools.bench.transport_peer", endpoint, raw_endpoint, path])
            try:
                socket.connect(path)
                yield _senders(link, session, socket), peer
            finally:
                peer.close()
                session.close()  # type: ignore[no-untyped-call]
                context.destroy(linger=0)


def _senders(link: Link, session: Any, socket: zmq.Socket[bytes]) -> dict[str, Send]:
    senders: dict[str, Send] = {}
    for size in SIZES:
        pixels = (
            np.arange(np.prod(SHAPES[size])).astype(np.uint8).reshape(SHAPES[size])
            if size in SHAPES
            else None
        )
        data = np.zeros(8, np.uint8) if pixels is None else pixels.reshape(-1)
        for kind in ("", "read ") if pixels is not None else ("",):
            way = channel(kind + size)
            link.advertise(way)
            payload = bytes(8) if pixels is None else Image(pixels, "rgb")
            senders[f"{kind or 'ours '}{size}"] = partial(_ours, link, way.key, way.port, payload)
            publisher = bare_publisher(session, raw_key(kind + size))
            senders[f"zenoh {kind}{size}"] = partial(_raw, publisher, data)
        senders[f"zmq {size}"] = partial(_zmq, socket, f"zmq {size}".encode(), data)
    return senders


def _ours(link: Link, key: str, port: str, payload: Any) -> None:
    now = time.monotonic_ns()
    link.publish(key, Envelope.of(Message.at(now, payload), port, now + 1), payload)


def _raw(publisher: Any, data: np.ndarray[Any, Any]) -> None:
    data[:8] = np.frombuffer(time.monotonic_ns().to_bytes(8, "little"), np.uint8)
    publisher.put(data.tobytes())


def _zmq(socket: zmq.Socket[bytes], side: bytes, data: np.ndarray[Any, Any]) -> None:
    data[:8] = np.frombuffer(time.monotonic_ns().to_bytes(8, "little"), np.uint8)
    socket.send_multipart([side, data.data], copy=False)


def latencies(peer: Peer, side: str, send: Send, count: int) -> list[float]:
    """Of one round, us. One of which less than half arrived, since the two processes have not met
    yet or another took the core, is measured anew, at half the pace."""
    for number in range(TRIES):
        for _ in paced(count + WARM_UP, PERIOD_S * 2**number):
            send()
        each: list[float] = peer.ask(side, count + WARM_UP)
        if len(each) >= (count + WARM_UP) // 2:
            return each[WARM_UP:]
    raise RuntimeError(f"{side}: {len(each)} of {count + WARM_UP} messages arrived, {TRIES} times")


def row(size: str, measured: dict[str, list[list[float]]]) -> Row:
    """A size beside an 8-byte hop of Zenoh, bare Zenoh of the same size, and ZeroMQ."""
    ours, raw, floor = (Latency(measured[f"{side} {size}"]) for side in ("ours", "zenoh", "zmq"))
    hop = Latency(measured["zenoh 8 B"])
    of_hop, of_raw = ratio(ours.p50, hop.p50), ratio(ours.p50, raw.p50)
    goals = [("p50 <= 1.5 x an 8-byte Zenoh hop", of_hop.median <= 1.5)] if size in SHAPES else []
    if size == "1.2 MB":
        goals.append(("<= 0.7 x Zenoh", of_raw.median <= 0.7))
    return Row(
        f"{size} to another process",
        ", ".join(goal for goal, _ in goals),
        str(ours),
        f"8-byte Zenoh hop: {hop}; Zenoh: {raw}; ZeroMQ ipc: {floor}",
        f"p50 {of_hop} of the hop, {of_raw} of Zenoh",
        all(met for _, met in goals) if goals else None,
        {
            "p50_us": median(ours.p50),
            "p99_us": median(ours.p99),
            "hop_p50_us": median(hop.p50),
            "zenoh_p50_us": median(raw.p50),
            "zmq_p50_us": median(floor.p50),
            "of_hop": of_hop.median,
            "of_zenoh": of_raw.median,
        },
    )


def read_row(size: str, measured: dict[str, list[list[float]]]) -> Row:
    """The same until every byte was read."""
    ours, raw = (Latency(measured[f"{side} {size}"]) for side in ("read", "zenoh read"))
    of_raw = ratio(ours.p50, raw.p50)
    return Row(
        f"{size} to another process, and read through",
        "",
        str(ours),
        f"Zenoh: {raw}",
        f"p50 {of_raw} of Zenoh",
        values={"p50_us": median(ours.p50), "zenoh_p50_us": median(raw.p50)},
    )


def cpu_of(peer: Peer, send: Send, side: str, seconds: int) -> Row:
    """CPU of both processes at 30 Hz."""
    began, before = time.perf_counter_ns(), time.process_time_ns() + peer.ask("cpu")
    count = seconds * HZ
    for _ in paced(count, 1 / HZ):
        send()
    peer.ask(side, count)
    busy = time.process_time_ns() + peer.ask("cpu") - before
    share = busy / (time.perf_counter_ns() - began)
    return Row(
        f"CPU at 30 Hz, {side.removeprefix('ours ')}, both processes",
        "<= 5 % of a core",
        f"{share:.1%} of a core, {busy / count / 1e3:.0f} us a message",
        met=share <= 0.05,
        values={"share": share, "us_per_message": busy / count / 1e3},
    )
