from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from pipeline.clock import ManualClock
from pipeline.drivers.exchange import Exchange
from pipeline.message import Message
from pipeline.scheduling.bounds import INFINITY
from pipeline.scheduling.events import Bound, InputSet, Run, Step, Took
from pipeline.scheduling.partition import Placement, part_of
from pipeline.scheduling.topology import Input, Policy, Port, StageNode, Topology
from pipeline.transport.bad_wire import WireFaults
from pipeline.transport.loopback import LoopbackNetwork
from pipeline.transport.schema import PayloadSchema

PORT = Port("a")


class Told:
    """A driver that notes what it is told."""

    def __init__(self) -> None:
        self.messages: list[Message[Any]] = []
        self.bounds: list[int] = []
        self.over: list[int] = []

    def arrived(self, port: Port, message: Message[Any]) -> None:
        assert port == PORT
        self.messages.append(message)

    def bounded(self, port: Port, bound: int) -> None:
        self.bounds.append(bound)

    def sent(self, runs: Sequence[Run]) -> None:
        self.over += [run.number for run in runs]


class Pair:
    """The two parts of a graph of one edge, over a loopback."""

    def __init__(
        self, folder: Path, policy: Policy, faults: Mapping[Port, WireFaults] | None = None
    ) -> None:
        self._network, self._folder = LoopbackNetwork(), folder
        self._faults = faults or {}
        trigger = Input("x", (PORT,), policy=policy, size=2)
        self._topology = Topology((StageNode("a"), StageNode("b", (trigger,), outputs=())))
        self._placement = Placement({"a": "one", "b": "two"}, {"one": "here", "two": "here"})
        self.entered = 0
        self.one, self.two = self.exchange("one"), self.exchange("two")
        self.sender = self.one.senders["a.out@here"]
        self.origin, self.reader = Told(), Told()
        self.one.begin(self.origin, ManualClock())
        self.two.begin(self.reader, ManualClock())

    def exchange(self, process: str, begun: Told | None = None) -> Exchange:
        def enter() -> None:
            self.entered += 1

        part = part_of(self._topology, self._placement, process)
        exchange = Exchange(
            "run", part, {PORT: PayloadSchema.of([str])}, enter, faults=self._faults
        )
        exchange.open(self._network.join(folder=self._folder))
        if begun is not None:
            exchange.begin(begun, ManualClock())
        exchange.connect()
        return exchange

    def forget_reader(self) -> None:
        """As if it were killed."""
        del self._network.members[1:]

    def repeat_news(self) -> None:
        """As the transport does after a silence."""
        self._network.ask_for_news(self.one.key(self.sender.link))

    def send(self, number: int) -> None:
        message = Message(f"m{number}", number, number, number, 50, number, (), "igpu", True)
        self.sender.execute(Run("a", number, InputSet(message, (message,)), 0), Step.PROCESS)


@pytest.fixture
def pair(tmp_path: Path) -> Pair:
    return Pair(tmp_path, Policy.LATEST)


@pytest.fixture
def blocking(tmp_path: Path) -> Pair:
    return Pair(tmp_path, Policy.BLOCK)


def test_a_message_arrives_as_its_port_took_it(pair: Pair) -> None:
    pair.send(0)
    [message] = pair.reader.messages
    assert (message.payload, message.stamp, message.received, message.seq) == ("m0", 0, 50, 0)
    assert (message.executor, message.degraded) == ("igpu", True)
    assert pair.two.missing() == []
    assert pair.entered == 1  # one thread, told once


def test_bounds_and_ends_arrive(pair: Pair) -> None:
    pair.one.tell(Bound("a.out@here", 70))
    pair.one.tell(Bound("a.out@here", INFINITY))
    assert pair.reader.bounds == [70, INFINITY]


def test_a_process_that_will_not_come_back_ends_its_streams(pair: Pair) -> None:
    pair.two.gone("one")
    assert pair.reader.bounds == [INFINITY]


def test_what_a_reader_took_ends_the_runs_of_the_sender(blocking: Pair) -> None:
    blocking.send(0)
    blocking.send(1)
    assert blocking.origin.over == []
    blocking.two.tell(Took(PORT, "b", 0))
    assert blocking.origin.over == [0]
    blocking.two.tell(Took(PORT, "b", 1))
    assert blocking.origin.over == [0, 1]


def test_a_sender_that_is_started_anew_waits_for_its_own_messages(blocking: Pair) -> None:
    for number in range(3):
        blocking.send(number)
        blocking.two.tell(Took(PORT, "b", number))
    again = blocking.exchange("one")
    again.begin(origin := Told(), ManualClock())
    sender = again.senders["a.out@here"]
    message = Message("anew", 90, 90, 90, 90, 0)
    sender.execute(Run("a", 0, InputSet(message, (message,)), 0), Step.PROCESS)
    assert origin.over == []  # the reader took three, but of the earlier life
    blocking.two.tell(Took(PORT, "b", 2))  # one that was still queued there
    assert origin.over == []
    blocking.two.tell(Took(PORT, "b", 0))
    assert origin.over == [0]


def test_both_ends_count(pair: Pair) -> None:
    pair.send(0)
    sent = {"port": "a/out", "sent": 1, "failed": 0, "sent_whole": 0}
    assert pair.one.books()["out"]["a.out@here"] == sent
    end = pair.two.books()["in"]["a/out"]
    assert (end["received"], end["lost"], end["refused"]) == (1, 0, {})


def test_what_a_cut_link_lost_does_not_hold_the_sender_back(tmp_path: Path) -> None:
    pair = Pair(tmp_path, Policy.BLOCK, {PORT: WireFaults(cut_at_s=1, restored_at_s=2)})
    pair.one.begin(pair.origin, clock := ManualClock())
    pair.two.begin(pair.reader, clock)
    pair.send(0)
    clock.advance_to(1_500_000_000)
    pair.send(1)
    pair.send(2)  # the window is full, and nobody will ever take these
    clock.advance_to(2_000_000_000)
    pair.repeat_news()
    assert pair.origin.over == []  # the reader still has the first
    pair.two.tell(Took(PORT, "b", 0))
    assert pair.origin.over == [0, 1, 2]
    assert pair.two.books()["in"]["a/out"]["lost"] == 2
    pair.send(3)
    pair.two.tell(Took(PORT, "b", 3))
    assert pair.origin.over == [0, 1, 2, 3]


def test_what_was_lost_after_all_was_taken_is_told_at_once(tmp_path: Path) -> None:
    pair = Pair(tmp_path, Policy.BLOCK, {PORT: WireFaults(cut_at_s=1, restored_at_s=2)})
    pair.one.begin(pair.origin, clock := ManualClock())
    pair.two.begin(pair.reader, clock)
    pair.send(0)
    pair.two.tell(Took(PORT, "b", 0))
    clock.advance_to(1_500_000_000)
    pair.send(1)
    clock.advance_to(2_000_000_000)
    pair.repeat_news()
    assert pair.origin.over == [0, 1]


def test_what_was_sent_before_a_reader_came_anew_does_not_hold_the_sender_back(
    blocking: Pair,
) -> None:
    blocking.forget_reader()
    blocking.send(0)
    blocking.send(1)  # the window is full, and its reader dead
    assert blocking.origin.over == []
    again = blocking.exchange("two", reader := Told())
    assert blocking.origin.over == [0, 1]
    blocking.send(2)
    assert [message.payload for message in reader.messages] == ["m2"]
    again.tell(Took(PORT, "b", 2))
    assert blocking.origin.over == [0, 1, 2]
