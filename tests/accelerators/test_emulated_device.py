from __future__ import annotations

import logging
import threading
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from accelerators import emulated
from accelerators.emulated import Emulated
from accelerators.faults import Faults
from accelerators.registry import Registry
from pipeline.errors import DeviceError, ModelError
from pipeline.model import Model, Native, Probe, TensorSpec


class Time:
    """Stands for the module `time`: a sleep takes exactly as long as it should, and no time."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> Time:
    stopped = Time()
    monkeypatch.setattr(emulated, "time", stopped)
    return stopped


class Slow:
    """A real device that takes `seconds` per run and answers with what it was given."""

    kinds: tuple[str, ...] = ("onnx",)

    def __init__(self, time: Time, seconds: float, *, available: bool = True) -> None:
        self._time, self._seconds, self._available = time, seconds, available
        self.inputs: Mapping[str, TensorSpec] = {"x": TensorSpec((1,), "float32")}
        self.outputs = self.inputs
        self.closed = False

    def probe(self) -> Probe:
        if not self._available:
            return Probe(False, "", "", "install it")
        return Probe(True, "Slow CPU", "slowrt 1.0")

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        return self

    def infer(self, inputs: Native) -> Native:
        self._time.now += self._seconds
        return dict(inputs)

    def close(self) -> None:
        self.closed = True


X = {"x": np.ones(1, np.float32)}
VARIANT = {
    "input": {"name": "x", "shape": (), "dtype": "float32"},
    "outputs": {"y": {"shape": (1,)}},
}


def load(device: Emulated, name: str = "a") -> Model:
    """The model on the device, warmed up."""
    model = device.load("", {"model": name, **VARIANT})
    model.infer(X)
    return model


def test_a_run_takes_the_declared_time(time: Time) -> None:
    model = load(Emulated(latency_ms={"a": 40.5}))
    start = time.now
    model.infer(X)
    assert time.now - start == pytest.approx(0.0405)


def test_two_models_on_one_device_take_turns(time: Time) -> None:
    device = Emulated(latency_ms={"a": 15, "b": 10})
    one, two = load(device, "a"), load(device, "b")
    start = time.now
    threads = [threading.Thread(target=model.infer, args=(X,)) for model in (one, two, one)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
    assert time.now - start == pytest.approx(0.040)


def test_a_sleep_that_ends_late_is_made_up_for_in_the_mean(time: Time) -> None:
    def sleep(seconds: float) -> None:
        time.now += seconds + 0.0003

    time.sleep = sleep  # type: ignore[method-assign]
    model = load(Emulated(latency_ms={"a": 10}))
    for _ in range(100):
        model.infer(X)
    start = time.now
    for _ in range(100):
        model.infer(X)
    assert (time.now - start) / 100 == pytest.approx(0.010, abs=1e-5)


def test_jitter_stays_in_its_bounds_and_repeats_with_its_seed(time: Time) -> None:
    def times(seed: int) -> list[float]:
        model = load(Emulated(latency_ms={"a": 10}, jitter_ms=2, seed=seed))
        found = []
        for _ in range(50):
            start = time.now
            model.infer(X)
            found.append((time.now - start) * 1e3)
        return found

    first = times(1)
    assert 7.99 < min(first) < 9
    assert 11 < max(first) < 12.01
    assert first == pytest.approx(times(1))
    assert first != pytest.approx(times(2))


def test_a_model_that_follows_another_pays_for_its_weights(time: Time) -> None:
    device = Emulated(latency_ms={"a": 10, "b": 10}, reload_ms={"a": 5})
    a, b = load(device, "a"), load(device, "b")
    took = []
    for model in (a, a, b, a):
        start = time.now
        model.infer(X)
        took.append((time.now - start) * 1e3)
    assert took == pytest.approx([15, 10, 10, 15])


def test_a_column_of_the_papers_table_can_be_taken_and_overruled() -> None:
    device = Emulated(latencies="paper.edgetpu", latency_ms={"detect-rgb": 20, "mine": 1})
    expected = {"segment-rgb": 40.5, "detect-rgb": 20, "detect-thermal": 12.0, "mine": 1}
    assert device.latency_ms == expected
    assert Emulated(latencies="paper.igpu").latency_ms["segment-scan"] == 32.0


@pytest.mark.parametrize("name", ["paper", "paper.gpu", ""])
def test_a_column_that_is_not_there_is_answered_with_those_that_are(name: str) -> None:
    with pytest.raises(ValueError, match=r"known: paper\.edgetpu, paper\.igpu"):
        Emulated(latencies=name)


def test_everything_it_shows_says_that_it_is_emulated(time: Time) -> None:
    for device in (Emulated(), Emulated(outputs=Slow(time, 0))):
        probe = device.probe()
        assert "emulated" in probe.name
        assert "emulated" in probe.runtime
    assert "zeros" in Emulated().probe().runtime
    assert "slowrt 1.0 on Slow CPU" in Emulated(outputs=Slow(time, 0)).probe().runtime


def test_a_model_without_a_latency_is_refused() -> None:
    with pytest.raises(ModelError, match=r"'detect-rgb': the emulated device has no latency_ms"):
        Registry.open().load("detect-rgb", Emulated(latency_ms={"segment-rgb": 1}))


@pytest.mark.parametrize(
    "wrong",
    [
        {"latency_ms": {"a": -1.0}},
        {"latency_ms": {"a": float("nan")}},
        {"jitter_ms": -1.0},
        {"reload_ms": {"a": -1.0}},
    ],
)
def test_a_negative_time_is_a_bad_option(wrong: dict[str, Any]) -> None:
    (name,) = wrong
    with pytest.raises(ValueError, match=f"{name} must not be negative"):
        Emulated(**wrong)


def test_outputs_come_from_the_real_network_in_the_declared_time(time: Time) -> None:
    device = Emulated(latency_ms={"a": 40}, outputs=Slow(time, 0.030))
    assert device.kinds == ("onnx",)
    model = load(device)
    start = time.now
    assert model.infer(X) == X
    assert time.now - start == pytest.approx(0.040)


def test_a_real_network_that_is_slower_sets_the_time_and_is_announced(
    time: Time, caplog: pytest.LogCaptureFixture
) -> None:
    real = Slow(time, 0.060)
    device = Emulated(latency_ms={"a": 40}, outputs=real)
    model = load(device)
    assert not caplog.text, "the warm-up may be slow"
    start = time.now
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            model.infer(X)
        assert time.now - start == pytest.approx(0.180)
        device.close()
    assert caplog.messages == [
        "emulated: the outputs of 'a' took 60.0 ms here, longer than the declared 40.0",
        "emulated: 3 of 3 runs of 'a' were slower than declared, at worst 60.0 ms",
    ]
    assert real.closed


def test_a_device_whose_outputs_cannot_be_computed_is_not_available(time: Time) -> None:
    probe = Emulated(outputs=Slow(time, 0, available=False)).probe()
    assert (probe.available, probe.reason) == (False, "emulated, and its outputs: install it")


def test_a_device_dies_and_returns_by_the_time_since_its_first_run(time: Time) -> None:
    device = Emulated(latency_ms={"a": 10}, faults=Faults(dies_at_s=3, returns_at_s=6))
    model = load(device)
    time.now += 50  # before the first run nothing counts
    model.infer(X)
    time.now += 3
    assert not device.probe().available
    with pytest.raises(DeviceError, match="the emulated device died, as its faults say"):
        model.infer(X)
    time.now += 3
    assert device.probe().available
    model.infer(X)


def test_a_run_that_raises_leaves_the_device_to_the_next(time: Time) -> None:
    model = load(Emulated(latency_ms={"a": 10}, faults=Faults(raises_every=2)))
    model.infer(X)
    with pytest.raises(DeviceError, match="failed this run"):
        model.infer(X)
    model.infer(X)


def test_a_hang_holds_the_device_for_its_time(time: Time) -> None:
    faults = Faults(hangs_at_s=0, hangs_for_s=0.001)
    model = load(Emulated(latency_ms={"a": 10}, faults=faults))
    assert model.infer(X)


def test_a_hang_without_end_ends_when_the_device_is_closed(time: Time) -> None:
    device = Emulated(latency_ms={"a": 10}, faults=Faults(hangs_at_s=0))
    model = load(device)
    said: list[str] = []

    def run() -> None:
        with pytest.raises(DeviceError) as caught:
            model.infer(X)
        said.append(str(caught.value))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    while not device.probe().reason:  # not there yet
        thread.join(timeout=0.01)
        assert thread.is_alive()
    assert device.probe().reason == "the emulated device hangs, as its faults say"
    device.close()
    thread.join(timeout=60)
    assert said == ["the emulated device was closed while it hung"]


def test_warming_up_is_struck_by_no_fault(time: Time) -> None:
    device = Emulated(latency_ms={"detect-rgb": 1}, faults=Faults(dies_at_s=0))
    assert Registry.open().load("detect-rgb", device).spec.name == "detect-rgb"
