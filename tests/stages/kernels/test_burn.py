from __future__ import annotations

import threading
import time

import pytest

from stages.kernels.burn import burn


@pytest.mark.parametrize("cpu_ms", [0.0, 3.0, 12.0])
def test_it_uses_the_cpu_time_it_was_told_to(cpu_ms: float) -> None:
    start = time.thread_time()
    burn(cpu_ms)
    used_ms = (time.thread_time() - start) * 1e3
    assert cpu_ms <= used_ms < cpu_ms + 3


def test_other_threads_run_python_meanwhile() -> None:
    """Told by the hand-over alone, so it holds on a busy machine too: with the GIL held, the main
    thread would not return from `wait` before the burning thread is done."""
    burning = threading.Thread(target=burn, args=(60,))
    burning.start()
    turns = 0
    while burning.is_alive():
        turns += 1
        time.sleep(0)
    assert turns > 10
