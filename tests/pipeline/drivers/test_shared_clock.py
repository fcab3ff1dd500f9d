from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from pipeline.clock import ManualClock
from pipeline.drivers.shared_clock import ENOUGH, ClockBeacon, ClockFollower
from pipeline.transport.channel import Arrival
from pipeline.transport.envelope import Envelope, Kind
from pipeline.transport.loopback import LoopbackNetwork

MS = 1_000_000


def beacon(graph: int) -> Arrival:
    return Arrival(Envelope(Kind.BOUND, "clock", graph), None)


@given(
    offset=st.integers(-(10**15), 10**15),
    delays=st.lists(st.integers(0, 500 * MS), min_size=ENOUGH, max_size=20),
)
def test_a_follower_is_behind_by_the_shortest_way_of_all(offset: int, delays: list[int]) -> None:
    """The hosts' clocks differ by any offset; a beacon goes out every 200 ms."""
    ours = [0]
    follower = ClockFollower(now_ns=lambda: ours[0])
    arrivals = sorted((200 * MS * n + delay, 200 * MS * n) for n, delay in enumerate(delays))
    for at, told in arrivals:
        ours[0] = at + offset
        follower.heard(beacon(told))
    known = follower.known()
    assert known is not None
    graph, then = known
    behind = (then - offset) - graph
    assert behind == min(delays)


def test_a_follower_waits_for_some_beacons() -> None:
    follower = ClockFollower(now_ns=lambda: 0)
    for _ in range(ENOUGH - 1):
        follower.heard(beacon(7))
    assert follower.known() is None
    follower.heard(beacon(7))
    assert follower.known() == (7, 0)


def test_beacons_go_through_the_transport() -> None:
    network = LoopbackNetwork()
    follower = ClockFollower(now_ns=lambda: 5)
    teller = ClockBeacon("run", "main", network.join())
    follower.listen("run", "main", network.join())
    for _ in range(ENOUGH):
        teller.tell(ManualClock(123))
    assert follower.known() == (123, 5)
