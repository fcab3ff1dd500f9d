from __future__ import annotations

import signal
import threading
from collections.abc import Iterator

import pytest
from driving import Apply, arrive, beat, drive

from pipeline.measuring.ending import Ended, stopped_by_signals
from pipeline.message import Message
from pipeline.scheduling.topology import Input, Port, StageNode

NODES = [StageNode("source"), StageNode("work", (Input("x", (Port("source"),)),), outputs=())]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_stops_and_the_second_one_interrupts(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    asked: list[signal.Signals] = []
    with stopped_by_signals(asked.append):
        arrive(number)
        assert asked == [number]
        with pytest.raises(KeyboardInterrupt):
            arrive(number)
    assert asked == [number]
    assert signal.getsignal(number) is before


def test_off_the_main_thread_signals_are_left_alone() -> None:
    before = signal.getsignal(signal.SIGINT)
    during: list[object] = []

    def look() -> None:
        with stopped_by_signals(lambda number: None):
            during.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert during == [before]


@pytest.mark.parametrize("live", [False, pytest.param(True, marks=pytest.mark.realtime)])
def test_a_driver_says_what_ended_its_run(live: bool) -> None:
    def endless() -> Iterator[Message[int]]:
        yield from beat(1_000_000, 1)

    stages = {"work": Apply(lambda x: None)}
    by_sources = drive(NODES, stages, {"source": beat(3, 1)}, live=live)
    by_time = drive(NODES, stages, {"source": endless()}, live=live, duration_s=0.05)
    stopped = drive(NODES, stages, {"source": endless()}, live=live, during=lambda d: d.stop())
    ends = [ran.ended for ran in (by_sources, by_time, stopped)]
    assert ends == [Ended.SOURCES, Ended.DURATION, Ended.STOPPED]
