"""A transport within one process: what is published is delivered before `publish` returns.

For tests, and as the yardstick of the contract: it uses the same ends as Zenoh does, shared memory
included, and only the network between them is missing.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.errors import TransportError
from pipeline.transport.channel import Arrival, Channel, TransportStatistics
from pipeline.transport.envelope import Envelope
from pipeline.transport.inlet import Inlet
from pipeline.transport.outlet import Outlet
from pipeline.transport.shared_files import FOLDER


class LoopbackNetwork:
    """What the transports of one test share."""

    def __init__(self) -> None:
        self._epochs = itertools.count()
        self._sent: deque[tuple[str, bytes, bytes]] = deque()
        self.members: list[LoopbackTransport] = []

    def join(self, run: str = "loopback", folder: Path = FOLDER) -> LoopbackTransport:
        """A new member, as a process that starts."""
        member = LoopbackTransport(self, run, next(self._epochs), folder)
        self.members.append(member)
        return member

    def send(self, key: str, head: bytes, body: bytes) -> None:
        """Note what is sent; a slot is announced before it is filled, so it is read later."""
        self._sent.append((key, head, body))

    def deliver(self) -> None:
        """Hand on everything that was sent."""
        while self._sent:
            sent = self._sent.popleft()
            for member in self.members:
                member.take(*sent)

    def ask_for_news(self, key: str) -> None:
        for member in self.members:
            member.repeat(key)
        self.deliver()


class LoopbackTransport:
    """One member of a `LoopbackNetwork`; a `Transport`."""

    def __init__(self, network: LoopbackNetwork, run: str, epoch: int, folder: Path) -> None:
        self._network = network
        self._run, self._epoch, self._folder = run, epoch, folder
        self._outlets: dict[str, Outlet] = {}
        self._inlets: dict[str, Inlet] = {}

    def advertise(self, channel: Channel) -> None:
        if channel.key in self._outlets:
            raise TransportError(f"{channel.key} is advertised already")
        send = partial(self._network.send, channel.key)
        outlet = Outlet(channel, send, run=self._run, epoch=self._epoch, folder=self._folder)
        self._outlets[channel.key] = outlet
        outlet.repeat()
        self._network.deliver()

    def publish(self, key: str, envelope: Envelope, payload: Any = None) -> None:
        self._outlets[key].publish(envelope, payload)
        self._network.deliver()

    def subscribe(self, channel: Channel, on_arrival: Callable[[Arrival], None]) -> None:
        if channel.key in self._inlets:
            raise TransportError(f"{channel.key} is subscribed already")
        self._inlets[channel.key] = Inlet(channel, on_arrival, folder=self._folder)
        self._network.ask_for_news(channel.key)

    def statistics(self) -> TransportStatistics:
        return TransportStatistics(
            {key: outlet.statistics() for key, outlet in self._outlets.items()},
            {key: inlet.statistics() for key, inlet in self._inlets.items()},
        )

    def close(self) -> None:
        if self in self._network.members:
            self._network.members.remove(self)
        for outlet in self._outlets.values():
            outlet.close()
        for inlet in self._inlets.values():
            inlet.close()

    def take(self, key: str, head: bytes, body: bytes) -> None:
        if (inlet := self._inlets.get(key)) is not None:
            inlet.take(head, len(body), lambda: body)

    def repeat(self, key: str) -> None:
        if (outlet := self._outlets.get(key)) is not None:
            outlet.repeat()
