"""What the tests of both transports share: a channel, its messages, and who listens."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from wire_payloads import Box

from pipeline.message import Message
from pipeline.transport.channel import Arrival, Channel
from pipeline.transport.envelope import Envelope, Kind
from pipeline.transport.schema import PayloadSchema

#: The run of this process: tests of other processes leave its shared memory alone.
RUN = f"test-{os.getpid()}"
CHANNEL = Channel("test/camera/out", "camera/out", PayloadSchema.of([Box]))


def until(condition: Callable[[], Any]) -> None:
    """Wait for what another thread does; fails after a minute."""
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


class Listener:
    """Keeps what arrives."""

    def __init__(self) -> None:
        self.arrivals: list[Arrival] = []
        self.first = threading.Event()

    def __call__(self, arrival: Arrival) -> None:
        self.arrivals.append(arrival)
        self.first.set()

    @property
    def messages(self) -> list[Arrival]:
        return [each for each in self.arrivals if each.envelope.kind is Kind.MESSAGE]

    @property
    def lost(self) -> int:
        return sum(each.lost for each in self.arrivals)


def box(corners: int, label: str = "car") -> Box:
    return Box(np.arange(corners, dtype=np.float32), label)


def envelope(number: int) -> Envelope:
    message = Message(None, number, number - 1, number + 1, number + 2, number)
    return Envelope.of(message, "camera/out", number + 1)
