"""Sources as their faults make them, in virtual time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import count, islice

import pytest
from driving import MS, Collect, beat, drive

from pipeline.drivers.faulty import Sampled, Unheard, faulty, with_faults
from pipeline.graph.faults import SourceFaults
from pipeline.message import Message
from pipeline.scheduling.topology import Input, Policy, Port, StageNode

ORIGIN = 7_000 * MS


def samples(number: int) -> Iterator[Message[int]]:
    """Every 100 ms from the origin, each 10 ms on its way."""
    for i in range(number):
        stamp = ORIGIN + i * 100 * MS
        yield Message.at(stamp - 10 * MS, i, received=stamp)


def through(number: int, faults: SourceFaults) -> list[Sampled]:
    return list(faulty(samples(number), faults, ORIGIN))


def heard(found: Sequence[Sampled]) -> list[int]:
    return [each.payload for each in found if isinstance(each, Message)]


def told(found: Sequence[Sampled]) -> list[tuple[int, str]]:
    """What is told, and when: ms from the origin."""
    return [
        ((each.received - ORIGIN) // MS, each.text)
        for each in found
        if isinstance(each, Unheard) and each.text is not None
    ]


def test_a_dead_source_is_silent_until_it_returns() -> None:
    found = through(10, SourceFaults(dies_at=250 * MS, returns_at=600 * MS))
    assert heard(found) == [0, 1, 2, 6, 7, 8, 9]
    assert told(found) == [(250, "dies, as its faults say"), (600, "is back from the dead")]


def test_a_source_that_stays_dead_takes_its_time_and_says_nothing() -> None:
    endless = (Message.at(ORIGIN + i * 100 * MS, i) for i in count())
    found = list(islice(faulty(endless, SourceFaults(dies_at=200 * MS), ORIGIN), 6))
    assert heard(found) == [0, 1]
    assert [(each.received - ORIGIN) // MS for each in found[3:]] == [200, 300, 400]


def test_a_repeated_message_comes_again_with_its_stamp_at_the_time_of_the_fault() -> None:
    found = through(4, SourceFaults(repeats_at=130 * MS))
    assert heard(found) == [0, 1, 1, 2, 3]
    first, again = [each for each in found if isinstance(each, Message) and each.payload == 1]
    assert again.stamp == first.stamp
    assert again.received == ORIGIN + 130 * MS


@pytest.mark.parametrize("by", [-250 * MS, 3_000 * MS])
def test_a_clock_that_jumps_shifts_stamps_and_not_arrivals(by: int) -> None:
    found = through(4, SourceFaults(jumps_at=200 * MS, jumps_by=by))
    messages = [each for each in found if isinstance(each, Message)]
    whole = list(samples(4))
    assert [a.stamp - b.stamp for a, b in zip(messages, whole, strict=True)] == [0, 0, by, by]
    assert [a.begin - a.stamp for a in messages] == [b.begin - b.stamp for b in whole]
    assert [a.received for a in messages] == [b.received for b in whole]


def test_what_a_stalled_source_held_up_arrives_at_once() -> None:
    found = through(8, SourceFaults(stalls_at=200 * MS, stalls_for=350 * MS))
    arrivals = [(m.received - ORIGIN) // MS for m in found if isinstance(m, Message)]
    assert arrivals == [0, 100, 550, 550, 550, 550, 600, 700]
    assert heard(found) == list(range(8))


def test_a_source_without_faults_is_left_as_it_is() -> None:
    messages = samples(3)
    assert with_faults({"lidar": messages}, {"camera": SourceFaults()}, 0)["lidar"] is messages


def test_offline_and_live_lose_the_same_messages_and_tell_the_same() -> None:
    keeps_all = Input("x", (Port("camera"),), policy=Policy.DROP_OLDEST, size=10)
    nodes = [StageNode("camera"), StageNode("sink", (keeps_all,), outputs=())]
    faults = SourceFaults(dies_at=60 * MS, returns_at=100 * MS, repeats_at=42 * MS)
    for live in (False, True):
        sink = Collect()
        sources = with_faults({"camera": iter(beat(10, 20))}, {"camera": faults}, 0)
        ran = drive(nodes, {"sink": sink}, sources, live=live)
        assert ran.statistics.failures == []
        assert [stamp // MS for stamp, _ in sink.seen] == [0, 20, 40, 100, 120, 140, 160, 180]
        assert sum(ran.statistics.refusals.values()) == 1  # the duplicate, at the port
        events = [(e.at_ns // MS, e.kind, e.subject) for e in ran.statistics.events]
        assert [event for event in events if event[1] == "fault"] == [
            (at, "fault", "camera") for at in (42, 60, 100)
        ]
