from __future__ import annotations

import os
import threading
import time

import pytest
from profiled_stages import burn

from pipeline.measuring import cpu_clocks
from pipeline.measuring.cpu_clocks import (
    PoolMeter,
    ProcessMeter,
    process_ns,
    thread_name,
    thread_ns,
    threads,
)

pytestmark = pytest.mark.skipif(not threads(), reason="needs the thread clocks of Linux")

NO_SUCH = 2**22 + 1  #: above the kernel's greatest process id


def test_a_threads_clock_is_the_one_that_python_reads() -> None:
    before = time.thread_time_ns()
    burn(10_000)
    read = thread_ns(threading.get_native_id())
    assert read is not None
    assert before < read <= time.thread_time_ns()


def test_a_processs_clock_is_the_one_that_python_reads() -> None:
    before = time.process_time_ns()
    read = process_ns(os.getpid())
    assert read is not None
    assert before <= read <= time.process_time_ns()


def test_what_is_gone_has_no_clock_and_no_name() -> None:
    assert thread_ns(NO_SUCH) is None
    assert process_ns(NO_SUCH) is None
    assert thread_name(NO_SUCH) == "ended"


def test_the_clocks_of_all_threads_are_the_clock_of_the_process() -> None:
    every = sum(thread_ns(tid) or 0 for tid in threads())
    assert every <= time.process_time_ns()  # those that have ended are in it, too
    assert threading.get_native_id() in threads()


def test_a_pool_keeps_what_a_thread_took_that_has_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    clocks: dict[int, int | None] = {1: 100, 2: 50}
    monkeypatch.setattr(cpu_clocks, "thread_ns", clocks.get)
    meter = PoolMeter(clocks)
    clocks |= {1: 130, 2: 55}
    assert meter.ns() == 35
    clocks |= {1: None, 2: 60}
    assert meter.ns() == 40


def test_a_process_that_was_replaced_keeps_what_it_took(monkeypatch: pytest.MonkeyPatch) -> None:
    class Child:
        pid: int | None = 7

    clocks: dict[int, int | None] = {7: 1000, 8: 300}
    monkeypatch.setattr(cpu_clocks, "process_ns", clocks.get)
    child = Child()
    meter = ProcessMeter(child)
    clocks[7] = 1500
    assert meter.ns() == 500
    clocks[7] = None
    child.pid = None
    assert meter.ns() == 500
    child.pid = 8
    assert meter.ns() == 800
    clocks[8] = 310
    assert meter.ns() == 810
