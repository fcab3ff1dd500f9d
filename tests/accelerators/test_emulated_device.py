from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from accelerators.emulated import Emulated
from accelerators.registry import Registry
from pipeline.errors import ModelError
from pipeline.model import Tensor


def test_an_infer_takes_the_declared_time() -> None:
    model = Registry.open().load("detect-rgb", Emulated(latency_ms={"detect-rgb": 20}))
    native = model.encode({"image": Tensor(np.zeros((1, 480, 848, 3), np.uint8))})
    start = time.monotonic()
    model.infer(native)
    assert 0.020 <= time.monotonic() - start < 0.5


def test_two_models_on_one_device_take_turns() -> None:
    device = Emulated(latency_ms={})
    start = time.monotonic()
    threads = [threading.Thread(target=device.hold, args=(15,)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert time.monotonic() - start >= 0.045


def test_everything_it_shows_says_that_it_is_emulated() -> None:
    probe = Emulated(latency_ms={}).probe()
    assert "emulated" in probe.name
    assert "emulated" in probe.runtime


def test_a_model_without_a_latency_is_refused() -> None:
    with pytest.raises(ModelError, match=r"'detect-rgb': the emulated device has no latency_ms"):
        Registry.open().load("detect-rgb", Emulated(latency_ms={"segment-rgb": 1}))


@pytest.mark.parametrize("latency_ms", [-1.0, float("nan")])
def test_a_negative_latency_is_a_bad_option(latency_ms: float) -> None:
    with pytest.raises(ValueError, match="must not be negative"):
        Emulated(latency_ms={"a": latency_ms})
