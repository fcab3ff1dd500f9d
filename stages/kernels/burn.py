"""CPU time spent on purpose, without the GIL."""

from __future__ import annotations

import hashlib
import time

#: About 0.15 ms of SHA-256 with the instructions for it. hashlib gives up the GIL from 2 KiB on.
_BLOCK = bytes(256 * 1024)


def burn(cpu_ms: float) -> None:
    """Use `cpu_ms` of the calling thread's CPU time; other threads run Python meanwhile.

    Measured on the thread's own clock: waiting for a core does not count. It overshoots by half a
    block on average.
    """
    end = time.thread_time() + cpu_ms / 1e3
    while time.thread_time() < end:
        hashlib.sha256(_BLOCK)
