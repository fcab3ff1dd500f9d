from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from parts import Parts, play
from scripts import examples

from pipeline.message import Message
from pipeline.scheduling.bounds import INFINITY
from pipeline.scheduling.events import Bound, Output, Took
from pipeline.scheduling.partition import Placement, links_between, part_of
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import (
    Input,
    Missing,
    Policy,
    Port,
    Role,
    StageNode,
    Sync,
    Topology,
)

MS = 1_000_000
FAST, SLOW, RELAY = Port("fast"), Port("slow"), Port("relay")


def placed(**process_of: str) -> Placement:
    return Placement(process_of, dict.fromkeys(process_of.values(), "here"))


def trigger(port: Port, policy: Policy = Policy.DROP_OLDEST, size: int = 8, **more: Any) -> Input:
    return Input("x", (port,), policy=policy, size=size, **more)


def graph(sync: Input, policy: Policy = Policy.DROP_OLDEST) -> Topology:
    """Two sources; a relay of the fast one; a pair of the slow one with the relay; two sinks."""
    return Topology(
        (
            StageNode("fast"),
            StageNode("slow"),
            StageNode("relay", (trigger(FAST),)),
            StageNode("pair", (trigger(SLOW), sync)),
            StageNode("end", (trigger(Port("pair"), policy, 3),), outputs=()),
            StageNode("other_end", (trigger(RELAY, period=40 * MS),), outputs=()),
        ),
        workers=64,
    )


def test_a_part_has_a_source_for_each_remote_stage_and_a_sender_for_each_read_port() -> None:
    topology = graph(Input("y", (RELAY,), sync=Sync.NEAREST, tolerance=20 * MS))
    placement = placed(fast="a", slow="b", relay="a", pair="b", end="b", other_end="c")
    part = part_of(topology, placement, "a")
    assert [node.name for node in part.topology.stages] == ["fast", "relay", "relay.out@here"]
    assert part.topology.stages[-1].role is Role.SENDER
    remote = part_of(topology, placement, "b").topology.stages[1]
    assert (remote.name, remote.role, remote.outputs) == ("relay", Role.REMOTE, ("out",))
    [link] = links_between(topology, placement)
    assert (link.port, link.origin, link.targets, link.window) == (RELAY, "a", ("b", "c"), None)


def test_a_sender_leaves_out_what_every_reader_leaves_out() -> None:
    topology = graph(Input("y", (RELAY,), sync=Sync.LATEST))
    alone = placed(fast="a", slow="a", relay="a", pair="a", end="a", other_end="c")
    assert part_of(topology, alone, "a").topology.stages[-1].trigger.period == 40 * MS
    both = placed(fast="a", slow="a", relay="a", pair="c", end="c", other_end="c")
    assert part_of(topology, both, "a").topology.stage("relay.out@here").trigger.period is None


def test_with_block_as_many_messages_are_on_their_way_as_the_reader_has_room_for() -> None:
    topology = Topology(
        (StageNode("fast"), StageNode("end", (trigger(FAST, Policy.BLOCK, 3),), outputs=()))
    )
    part = part_of(topology, placed(fast="a", end="b"), "a")
    scheduler, runs = Scheduler(part.topology), []
    for number in range(4):
        assert scheduler.ready("fast")
        message = Message.at(number, number)
        runs += [start.run for start in scheduler.publish(FAST, message, number)]
    assert len(runs) == 3  # the window; the fourth waits here
    assert not scheduler.ready("fast")
    [start] = scheduler.step_done(runs[0], 5, ())
    assert scheduler.ready("fast")
    assert start.run.inputs.trigger.seq == 3


def test_a_reader_with_block_tells_what_it_took() -> None:
    topology = Topology(
        (StageNode("fast"), StageNode("end", (trigger(FAST, Policy.BLOCK, 3),), outputs=()))
    )
    scheduler = Scheduler(part_of(topology, placed(fast="a", end="b"), "b").topology)
    [start] = scheduler.arrived(FAST, Message.at(10, "x"), 10)
    assert scheduler.notices() == [Took(FAST, "end", 0)]
    scheduler.arrived(FAST, Message(None, 20, 20, 20, 20, seq=1), 20)
    assert scheduler.notices() == []  # queued
    scheduler.step_done(start.run, 30, ())
    assert scheduler.notices() == [Took(FAST, "end", 1)]
    scheduler.stop(40)
    scheduler.arrived(FAST, Message(None, 50, 50, 50, 50, seq=2), 50)
    assert scheduler.notices() == [Took(FAST, "end", 2)]  # ended on arrival


def test_a_message_keeps_what_its_own_process_says_of_it() -> None:
    topology = Topology((StageNode("fast"), StageNode("end", (trigger(FAST),), outputs=())))
    scheduler = Scheduler(part_of(topology, placed(fast="a", end="b"), "b").topology)
    sent = Message("x", 10, 9, 11, 12, seq=7, executor="igpu", degraded=True)
    [start] = scheduler.arrived(FAST, sent, 20)
    assert start.run.inputs.trigger is sent


def test_a_bound_is_told_only_when_nothing_below_it_is_on_its_way() -> None:
    topology = Topology(
        (
            StageNode("fast"),
            StageNode("relay", (trigger(FAST),)),
            StageNode("end", (trigger(RELAY),), outputs=()),
        )
    )
    scheduler = Scheduler(part_of(topology, placed(fast="a", relay="a", end="b"), "a").topology)
    [run] = scheduler.publish(FAST, Message.at(10, "x"), 10)
    assert scheduler.notices() == [Bound("relay.out@here", 10)]  # the relay may still say 10
    assert scheduler.step_done(run.run, 20, []) == []  # it said nothing
    assert scheduler.notices() == [Bound("relay.out@here", 11)]
    [run] = scheduler.publish(FAST, Message.at(20, "x"), 20)
    scheduler.notices()
    [sending] = scheduler.step_done(run.run, 30, [Output(0, "y")])
    assert scheduler.source_ended("fast", 30) == []
    assert scheduler.notices() == []  # the message goes first
    scheduler.step_done(sending.run, 40, ())
    assert scheduler.notices() == [Bound("relay.out@here", INFINITY)]


arrivals = st.lists(st.tuples(st.integers(0, 30), st.integers(0, 8)), min_size=3, max_size=14)


@st.composite
def flights(draw: st.DrawFn) -> tuple[Topology, Placement, list[tuple[int, Port, int]]]:
    """A graph, where its stages run, and what its sources bring, with jitter and gaps."""
    kind = draw(st.sampled_from([Sync.NEAREST, Sync.EXACT, Sync.LATEST, Sync.SPAN]))
    sync = Input(
        "y",
        (RELAY,),
        sync=kind,
        tolerance=draw(st.integers(0, 30)) * MS if kind is Sync.NEAREST else 0,
        max_wait=draw(st.integers(10, 200)) * MS,
        missing=draw(st.sampled_from([Missing.PROCEED, Missing.SKIP])),
    )
    topology = graph(sync, draw(st.sampled_from([Policy.DROP_OLDEST, Policy.BLOCK])))
    names = [node.name for node in topology.stages]
    placement = placed(**{name: draw(st.sampled_from("abc")) for name in names})
    found: list[tuple[int, Port, int]] = []
    for port, period in ((FAST, 20), (SLOW, 50)):
        last = at = 0
        for number, (jitter, delay) in enumerate(draw(arrivals)):
            stamp = max(last + 1, (number * period + jitter) * MS)
            at = max(at, stamp + delay * MS)
            last = stamp
            found.append((at, port, stamp))
    return topology, placement, found


@pytest.mark.slow
@examples(200)
@given(flight=flights())
def test_a_graph_in_processes_forms_the_sets_and_books_of_the_whole_graph(
    flight: tuple[Topology, Placement, list[tuple[int, Port, int]]],
) -> None:
    topology, placement, found = flight
    together = placed(**dict.fromkeys(placement.process_of, "a"))
    whole, cut = Parts(topology, together), Parts(topology, placement)
    assert play(cut, found, ["fast", "slow"]) == play(whole, found, ["fast", "slow"])
    assert cut.ledger() == whole.ledger()
