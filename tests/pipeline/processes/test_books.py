from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from pipeline.processes.books import merged_ledger
from pipeline.scheduling.ledger import balanced
from pipeline.scheduling.partition import Placement
from pipeline.scheduling.topology import Input, Port, StageNode, Topology

PORT = Port("a")
TOPOLOGY = Topology((StageNode("a"), StageNode("b", (Input("x", (PORT,)),), outputs=())))
APART = Placement({"a": "one", "b": "two"}, {"one": "here", "two": "here"})
EDGE, SENT = "a/out->b/x", "a/out->a.out@here/message"


@dataclass
class Process:
    name: str
    report: dict[str, Any] | None = None
    page: dict[str, Any] = field(default_factory=dict)
    past: list[dict[str, Any]] = field(default_factory=list)


def book(
    produced: int, delivered: int, in_flight: int = 0, **dropped: int
) -> dict[str, int | dict[str, int]]:
    return {
        "produced": produced,
        "delivered": delivered,
        "reused": 0,
        "dropped": dropped,
        "in_flight": in_flight,
    }


def sent(**page: Any) -> dict[str, Any]:
    return {"edges": {SENT: page["page"]}, "links": {"in": {}}, "refused": {}}


def read(page: dict[str, Any], lost: int = 0, **refused: int) -> dict[str, Any]:
    links = {"in": {"a/out": {"lost": lost}}}
    return {"edges": {EDGE: page}, "links": links, "refused": {"a/out": refused}}


def merged(*processes: Process) -> dict[str, Any]:
    ledger = merged_ledger(TOPOLOGY, APART, processes)
    assert balanced(ledger)
    return ledger[EDGE]


def test_what_the_reader_missed_is_lost_and_what_was_on_its_way_ended() -> None:
    one = Process("one", sent(page=book(100, 97, decimated=3)))
    two = Process("two", read(book(90, 80, replaced=10), lost=5))
    dropped = {"decimated": 3, "end": 2, "lost_in_transport": 5, "replaced": 10}
    assert merged(one, two) == book(100, 80, **dropped)


def test_what_the_readers_port_refused_is_lost() -> None:
    one = Process("one", sent(page=book(10, 10)))
    two = Process("two", read(book(8, 8), lost=1, backward=1))
    assert merged(one, two) == book(10, 8, lost_in_transport=2)


def test_what_a_killed_reader_may_have_received_is_lost_and_what_it_held_stopped() -> None:
    one = Process("one", sent(page=book(100, 100)))
    first = {"edges": {EDGE: book(40, 37, in_flight=3)}}
    two = Process("two", read(book(50, 50)), past=[first])
    assert merged(one, two) == book(100, 87, lost_in_transport=10, stage_stopped=3)


def test_a_killed_senders_page_may_be_older_than_what_arrived() -> None:
    one = Process("one", sent(page=book(20, 20)), past=[{"edges": {SENT: book(30, 30)}}])
    two = Process("two", read(book(54, 54)))
    assert merged(one, two) == book(54, 54)


def test_while_it_runs_a_message_is_in_flight_at_both_ends() -> None:
    one = Process("one", page={"edges": {SENT: book(12, 10, in_flight=2)}})
    two = Process("two", page={"edges": {EDGE: book(9, 7, in_flight=2)}})
    assert merged(one, two) == book(12, 7, in_flight=4, lost_in_transport=1)


def test_of_an_edge_to_another_host_each_end_knows_its_own_book() -> None:
    one = Process("one", sent(page=book(10, 9, decimated=1)))
    assert merged_ledger(TOPOLOGY, APART, [one])[EDGE] == book(10, 9, decimated=1)
    two = Process("two", read(book(8, 8)))
    assert merged_ledger(TOPOLOGY, APART, [two])[EDGE] == book(8, 8)


def test_of_a_port_on_another_host_the_readers_end_tells_what_was_lost() -> None:
    two = Process("two", read(book(39, 36, replaced=3), lost=111, backward=1))
    assert merged(two) == book(151, 36, lost_in_transport=112, replaced=3)


def test_while_it_runs_nothing_is_known_of_another_hosts_losses() -> None:
    assert merged(Process("two", page={"edges": {EDGE: book(5, 4, 1)}})) == book(5, 4, 1)
