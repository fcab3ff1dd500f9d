"""CPU clocks of threads and processes, in ns, and which threads this process has.

A thread's clock is exact and takes 0.5 us to read; psutil's per-thread times have ticks of 10 ms.
Where the kernel has no such clocks (not Linux) a clock reads None and the list of threads is empty.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

_TASKS = Path("/proc/self/task")
_THREAD, _PROCESS = (
    6,
    2,
)  #: CPUCLOCK_SCHED of the kernel's clock ids, with and without its thread bit


def thread_ns(tid: int) -> int | None:
    """CPU time of a thread of this process by its native id; None where it is gone."""
    return _read(~tid << 3 | _THREAD)


def process_ns(pid: int) -> int | None:
    """CPU time of any process, all its threads together; None where it is gone."""
    return _read(~pid << 3 | _PROCESS)


def threads() -> frozenset[int]:
    """Native ids of the threads that this process has now."""
    try:
        return frozenset(int(task.name) for task in _TASKS.iterdir())
    except OSError:
        return frozenset()


def thread_name(tid: int) -> str:
    """The name that `top -H` shows."""
    try:
        return (_TASKS / str(tid) / "comm").read_text().strip()
    except OSError:
        return "ended"


def _read(clock: int) -> int | None:
    try:
        return time.clock_gettime_ns(clock)
    except OSError:
        return None


class Meter(Protocol):
    """CPU time that a device takes beside the threads that call it."""

    def ns(self) -> int:
        """Since the meter was made."""
        ...


class PoolMeter:
    """Threads of this process."""

    def __init__(self, tids: Iterable[int]) -> None:
        self._since: dict[int, int] = {}
        self._last: dict[int, int] = {}
        self.add(tids)

    def add(self, tids: Iterable[int]) -> None:
        """Count these threads, too, from now on."""
        for tid in tids:
            self._since[tid] = self._last[tid] = thread_ns(tid) or 0

    def ns(self) -> int:
        for tid in self._last:
            self._last[tid] = max(self._last[tid], thread_ns(tid) or 0)  # a dead one keeps its last
        return sum(self._last.values()) - sum(self._since.values())


class Child(Protocol):
    """What has a process of its own."""

    @property
    def pid(self) -> int | None: ...


class ProcessMeter:
    """A process that may be replaced by a new one; what the old one took stays."""

    def __init__(self, child: Child) -> None:
        self._child = child
        self._process = child.pid
        self._last = self._clock()
        self._before = -self._last

    def ns(self) -> int:
        if self._process != (pid := self._child.pid):
            self._before += self._last
            self._process, self._last = pid, 0
        self._last = max(self._last, self._clock())
        return self._before + self._last

    def _clock(self) -> int:
        return 0 if self._process is None else process_ns(self._process) or 0


class OurThread:
    """A thread of the framework: the calling one."""

    __slots__ = ("_ended", "_since", "ns", "tid")

    def __init__(self, since: int) -> None:
        self.tid = threading.get_native_id()
        self.ns = 0
        self._since = since  #: its clock when the run began
        self._ended = False

    def begin(self) -> None:
        """The run begins now; what the thread took before is none of it."""
        self.ns, self._since = 0, thread_ns(self.tid) or 0

    def read(self) -> None:
        if not self._ended:
            self.ns = max(self.ns, (thread_ns(self.tid) or 0) - self._since)

    def end(self) -> None:
        """Take the last reading, on the thread itself."""
        self.ns = time.thread_time_ns() - self._since
        self._ended = True
