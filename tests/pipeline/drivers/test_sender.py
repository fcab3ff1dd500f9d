from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from pipeline.drivers.executor import Pending
from pipeline.drivers.sender import GONE_S, Sender
from pipeline.errors import WireError
from pipeline.message import Message
from pipeline.scheduling.events import InputSet, Run, Step
from pipeline.scheduling.partition import Link
from pipeline.scheduling.topology import Port


def run(number: int) -> Run:
    message: Message[Any] = Message(number, number, number, number, number, seq=number)
    return Run("s", number, InputSet(message, (message,)), 0)


def link(window: int | None, *waiting: str) -> Link:
    return Link(Port("a"), "one", waiting or ("two",), "here", True, window, waiting)


class Now:
    """Seconds that stand still."""

    def __init__(self) -> None:
        self.s = 100.0

    def __call__(self) -> float:
        return self.s


def numbers(runs: Sequence[Run]) -> list[int]:
    return [run.number for run in runs]


def test_without_a_window_a_run_ends_when_its_message_is_sent() -> None:
    sent: list[Message[Any]] = []
    assert Sender(link(None), sent.append).execute(run(0), Step.PROCESS) == ()
    assert [message.payload for message in sent] == [0]


def test_with_a_window_messages_leave_in_the_order_of_their_runs() -> None:
    sent: list[Message[Any]] = []
    sender = Sender(link(4, "two"), sent.append)
    for number in (1, 2, 0, 3):  # started in order, executed by two threads
        assert isinstance(sender.execute(run(number), Step.PROCESS), Pending)
    assert [message.payload for message in sent] == [0, 1, 2, 3]


def test_with_a_window_a_run_ends_when_every_reader_that_waits_took_its_message() -> None:
    now = Now()
    sender = Sender(link(4, "two", "three"), lambda message: None, now)
    sender.heard("two", -1)
    sender.heard("three", -1)
    for number in range(3):
        sender.execute(run(number), Step.PROCESS)
    assert sender.over() == []
    sender.heard("two", 2)
    sender.heard("three", 0)
    assert numbers(sender.over()) == [0]
    sender.heard("three", 2)
    assert numbers(sender.over()) == [1, 2]


def test_a_reader_that_is_gone_holds_nobody_back_until_it_returns() -> None:
    now = Now()
    sender = Sender(link(4, "two"), lambda message: None, now)
    sender.heard("two", -1)
    sender.execute(run(0), Step.PROCESS)
    assert sender.over() == []
    now.s += GONE_S + 0.1
    assert numbers(sender.over()) == [0]
    sender.execute(run(1), Step.PROCESS)
    assert numbers(sender.over()) == [1]
    sender.heard("two", -1)  # back, with nothing taken yet
    sender.execute(run(2), Step.PROCESS)
    assert sender.over() == []


def test_what_cannot_travel_is_counted_and_holds_nobody_back() -> None:
    def refuse(message: Message[Any]) -> None:
        raise WireError("oversized", "too large")

    with_window = Sender(link(4, "two"), refuse)
    with_window.execute(run(0), Step.PROCESS)
    assert with_window.failed == 1
    assert numbers(with_window.over()) == [0]
    with pytest.raises(WireError):
        Sender(link(None), refuse).execute(run(0), Step.PROCESS)
