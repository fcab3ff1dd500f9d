"""A recorded run is decided again as it was, whatever the graph; a changed one is found out."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from recording_runs import MS, topology
from scripts import Script, examples, scripts
from virtual_time import drive

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording.flight import Event, frozen
from pipeline.recording.reenactment import Different, Reenactment
from pipeline.recording.tap import Row, TappedScheduler
from pipeline.scheduling.events import Observer
from pipeline.scheduling.topology import Port, Topology


def play(script: Script) -> list[Event]:
    """The events of a script, as they come back from a file."""
    rows: list[Row] = []

    class Tapped(TappedScheduler):
        def __init__(
            self, of: Topology, *, offline: bool = False, observer: Observer | None = None
        ) -> None:
            super().__init__(of, Keeper(), offline=offline, observer=observer)

    class Keeper:
        def row(self, row: Row) -> None:
            rows.append(row)

        def message(self, port: Port, message: Message[Any]) -> bool:
            return True

    drive(script, Tapped)
    return [Event(*row[:3], frozen(row[3]), frozen(row[4])) for row in json.loads(json.dumps(rows))]


def repeat(of: Topology, events: list[Event], *, offline: bool = False) -> Reenactment:
    again = Reenactment(of, offline=offline)
    for event in events:
        again.step(event)
    return again


@examples(40)
@given(script=scripts())
def test_every_run_of_every_graph_is_decided_again_as_it_was(script: Script) -> None:
    events = play(script)
    again = repeat(script.topology, events, offline=script.offline)
    assert again.scheduler.quiescent()


@examples(20)
@given(script=scripts(), data=st.data())
def test_one_message_with_another_stamp_is_found_out(script: Script, data: Any) -> None:
    events = play(script)
    taken = [
        number
        for number, event in enumerate(events)
        if event.name == "publish" and event.followed[0][0] == "out"
    ]
    assume(taken)
    number = data.draw(st.sampled_from(taken))
    event = events[number]
    stage, port, stamp, *more = event.said
    events[number] = event._replace(said=(stage, port, stamp + 1, *more))
    with pytest.raises(Different) as caught:
        repeat(script.topology, events, offline=script.offline)
    assert f"event {event.number}, publish {stage} {port} {stamp + 1}" in str(caught.value)


@examples(20)
@given(script=scripts(), data=st.data())
def test_an_event_that_came_later_is_found_out_or_changes_nothing(
    script: Script, data: Any
) -> None:
    """A wake-up that fired a set, moved behind the next event."""
    events = play(script)
    places = [n for n, event in enumerate(events[:-1]) if event.followed and events[n + 1].followed]
    assume(places)
    place = data.draw(st.sampled_from(places))
    one, two = events[place : place + 2]
    events[place : place + 2] = [two, one]
    try:
        again = repeat(script.topology, events, offline=script.offline)
    except (Different, DataError):
        return
    assert again.scheduler.quiescent()


def test_a_difference_says_what_followed_then_and_now() -> None:
    publish = Event(
        0, "publish", 6 * MS, ("lidar", "out", 5, 0, 0), (("out", "lidar", "out", 0, 5),)
    )
    other = publish._replace(followed=(*publish.followed, ("drop", "lidar", "out", "fuse", "a", 0)))
    with pytest.raises(Different) as caught:
        repeat(topology(), [other])
    assert str(caught.value) == (
        "event 0, publish lidar out 5 0 0 at 0.006000 s: what follows was drop lidar out fuse a 0 "
        "in the flight and is nothing here"
    )


@pytest.mark.parametrize(
    "event",
    [
        Event(0, "publish", 0, ("nobody", "out", 5, 0, 0), ()),
        Event(0, "publish", 0, ("lidar",), ()),
        Event(0, "step_done", 0, (7, ()), ()),
        Event(0, "explode", 0, (), ()),
        Event(0, "device_down", 0, ("edgetpu",), ()),
        Event(0, "__init__", 0, (), ()),
    ],
)
def test_an_event_that_cannot_be_is_an_error_with_its_number(event: Event) -> None:
    with pytest.raises(DataError, match=r"event 0 .* does not fit the recorded graph"):
        repeat(topology(), [event])
