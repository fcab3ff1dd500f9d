from __future__ import annotations

import threading

import pytest

from pipeline.errors import TransportError
from pipeline.transport import courier as module
from pipeline.transport.courier import Courier

Sent = tuple[bytes, bytes]


class Road:
    """A link that takes one thing at a time, when it is let."""

    def __init__(self) -> None:
        self.sent: list[Sent] = []
        self.free = threading.Semaphore(0)
        self.taken = threading.Semaphore(0)
        self.under_way = threading.Semaphore(0)

    def send(self, head: bytes, body: bytes) -> None:
        self.under_way.release()
        assert self.free.acquire(timeout=60)
        self.sent.append((head, body))
        self.taken.release()


def test_a_newer_message_takes_the_place_of_one_that_waits_and_of_news_before_it() -> None:
    road = Road()
    courier = Courier("to-x", road.send)
    courier.send(b"0", b"frame")
    assert road.under_way.acquire(timeout=60)
    for head, body in ((b"1", b"frame"), (b"after 1", b""), (b"2", b"frame"), (b"after 2", b"")):
        courier.send(head, body)  # returns at once: the link is busy
    courier.send(b"end", b"")
    road.free.release(3)
    for _ in range(3):
        assert road.taken.acquire(timeout=60)
    assert road.sent == [(b"0", b"frame"), (b"2", b"frame"), (b"end", b"")]
    courier.close()


def test_the_end_of_a_stream_gets_out_before_the_link_is_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "LINGER_S", 60.0)  # the thread may stand still for a while
    road = Road()
    road.free.release(2)
    courier = Courier("to-x", road.send)
    courier.send(b"0", b"frame")
    courier.send(b"end", b"")
    courier.close()
    assert road.sent[-1] == (b"end", b"")


def test_a_closed_session_ends_it() -> None:
    tried = threading.Event()

    def closed(head: bytes, body: bytes) -> None:
        tried.set()
        raise TransportError("closed")

    courier = Courier("to-x", closed)
    courier.send(b"0", b"frame")
    assert tried.wait(60)
    courier.close()
