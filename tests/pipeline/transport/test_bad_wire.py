from __future__ import annotations

import threading
from math import inf

from pipeline.transport.bad_wire import BadWire, WireFaults
from pipeline.transport.channel import Arrival, Channel
from pipeline.transport.envelope import Envelope, Kind, pack
from pipeline.transport.inlet import Inlet
from pipeline.transport.outlet import Outlet
from pipeline.transport.schema import PayloadSchema

MESSAGE = pack(Envelope(Kind.MESSAGE, "a/out", 1))
NEWS = pack(Envelope(Kind.BOUND, "a/out", 1))


class Line:
    """What comes out at the far end of a wire, and the time that the wire sees."""

    def __init__(self, faults: WireFaults, name: str = "a/out") -> None:
        self.out: list[bytes] = []
        self.elapsed_s = 0.0
        self.wire = BadWire(faults, name)
        self.send = self.wire.lay(lambda head, body: self.out.append(body))

    def begin(self) -> None:
        self.wire.begin(lambda: self.elapsed_s)


def test_a_cut_wire_lets_nothing_through_until_it_is_restored() -> None:
    line = Line(WireFaults(cut_at_s=1, restored_at_s=2))
    line.send(NEWS, b"before the run")
    line.begin()
    for at in (0.9, 1.0, 1.9, 2.0):
        line.elapsed_s = at
        line.send(MESSAGE, str(at).encode())
        line.send(NEWS, b"news")
    assert line.out == [b"before the run", b"0.9", b"news", b"2.0", b"news"]


def test_a_tenth_of_the_messages_is_lost_the_same_by_the_same_seed_and_no_news() -> None:
    def lost(seed: int, name: str = "a/out") -> list[int]:
        line = Line(WireFaults(drops=0.1, seed=seed), name)
        line.begin()
        for number in range(2_000):
            line.send(MESSAGE, str(number).encode())
            line.send(NEWS, b"news")
        assert line.out.count(b"news") == 2_000
        arrived = set(line.out)
        return [number for number in range(2_000) if str(number).encode() not in arrived]

    assert 140 < len(lost(1)) < 260
    assert lost(1) == lost(1)
    assert lost(1) != lost(2)
    assert lost(1) != lost(1, "b/out")


def test_a_slow_wire_delivers_later_in_order_and_all_at_its_end() -> None:
    now = [0.0]
    out: list[bytes] = []
    three = threading.Event()
    wire = BadWire(WireFaults(delay_s=0.2), "a/out", lambda: now[0])

    def arrive(head: bytes, body: bytes) -> None:
        out.append(body)
        if len(out) == 3:
            three.set()

    send = wire.lay(arrive)
    wire.begin(lambda: 0.0)
    for number in range(3):
        send(MESSAGE, b"%d" % number)
    assert out == []  # its time stands still
    now[0] = 0.2
    send(MESSAGE, b"3")
    assert three.wait(60)
    assert out == [b"0", b"1", b"2"]
    wire.close()
    assert out == [b"0", b"1", b"2", b"3"]


def test_what_a_wire_swallowed_is_counted_by_the_reader_as_lost() -> None:
    elapsed = [0.0]
    wire = BadWire(WireFaults(cut_at_s=1, restored_at_s=3), "a/out")
    channel = Channel("key", "a/out", PayloadSchema.of([str]), wire=wire.lay)
    arrivals: list[Arrival] = []
    inlet = Inlet(channel, arrivals.append)
    outlet = Outlet(
        channel, lambda head, body: inlet.take(head, len(body), lambda: body), run="t", epoch=1
    )
    wire.begin(lambda: elapsed[0])
    for second in range(4):
        elapsed[0] = float(second)
        outlet.publish(Envelope(Kind.MESSAGE, "a/out", second + 1, stamp=second), f"m{second}")
    assert [arrival.payload for arrival in arrivals] == ["m0", "m3"]
    assert inlet.statistics().lost == arrivals[-1].lost == 2
    outlet.close()
    inlet.close()


def test_faults_that_are_not_said_do_nothing() -> None:
    assert WireFaults().cut_at_s == WireFaults().restored_at_s == inf
    line = Line(WireFaults())
    line.begin()
    line.send(MESSAGE, b"x")
    line.wire.close()
    assert line.out == [b"x"]
