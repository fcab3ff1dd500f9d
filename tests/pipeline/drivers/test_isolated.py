"""Isolated devices: the process may crash, hang, or be killed; ours goes on."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import isolated_devices
import numpy as np
import psutil
import pytest
from descriptors import descriptors
from isolated_devices import Doubler

from pipeline.drivers.isolated import IsolatedDevice
from pipeline.errors import DeviceError, ModelError
from pipeline.graph.graph import GraphDevice
from pipeline.graph.nodes import Mark, Node, Origin
from pipeline.transport import child
from pipeline.transport.child import Restarts

pytestmark = pytest.mark.slow  # a process takes some 0.3 s to start

ALWAYS = Restarts("always")
MARK = Mark(Origin("test.yaml", Path(), 0))


def isolated(restarts: Restarts = ALWAYS, **options: Any) -> IsolatedDevice:
    block = Node({name: Node(value, MARK) for name, value in options.items()}, MARK)
    use = f"{isolated_devices.__name__}:Doubler"
    return IsolatedDevice(GraphDevice("tpu", use, Doubler, options, block, restarts), restarts)


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine may take long to end a process: how that ended is told all the same."""
    monkeypatch.setattr(child, "DEATH_S", 60.0)


@pytest.fixture
def device() -> Iterator[IsolatedDevice]:
    made = isolated()
    yield made
    made.close()


def x(number: float) -> dict[str, Any]:
    return {"x": np.full(4, number, np.float32)}


def test_a_model_answers_as_it_would_here_from_a_process_of_its_own() -> None:
    device = isolated(gain=3.0)
    try:
        probe = device.probe()
        model = device.load("any", {"kind": "double"})
        assert probe.available
        assert probe.name == f"pid {device.pid}" != f"pid {os.getpid()}"
        assert model.inputs == isolated_devices.Double.inputs
        assert model.outputs == isolated_devices.Double.outputs
        np.testing.assert_array_equal(model.infer(x(7))["y"], np.full(4, 21))
    finally:
        device.close()


def test_errors_keep_their_kind_and_text(device: IsolatedDevice) -> None:
    with pytest.raises(ModelError, match="missing: no such model"):
        device.load("missing", {})
    model = device.load("any", {})
    with pytest.raises(DeviceError, match="this one fails"):
        model.infer(x(Doubler.RAISE))
    assert model.infer(x(1))["y"][0] == 2


@pytest.mark.parametrize(
    ("number", "how"),
    [(Doubler.SEGFAULT, "was killed by SIGSEGV"), (Doubler.EXIT, "ended with exit code 3")],
)
def test_a_crash_is_an_error_of_the_run_and_the_next_probe_starts_anew(
    device: IsolatedDevice, number: int, how: str
) -> None:
    model = device.load("any", {})
    with pytest.raises(DeviceError, match=how):
        model.infer(x(number))
    with pytest.raises(DeviceError, match=how):  # it went with its process
        model.infer(x(1))
    assert device.probe().available
    again = device.pid
    with pytest.raises(DeviceError, match="was started anew since"):
        model.infer(x(1))
    assert device.load("any", {}).infer(x(5))["y"][0] == 10
    assert device.pid == again


def test_a_kill_from_outside_is_an_error_of_the_run(device: IsolatedDevice) -> None:
    model = device.load("any", {})
    assert device.pid is not None
    os.kill(device.pid, signal.SIGKILL)
    with pytest.raises(DeviceError, match="SIGKILL"):
        model.infer(x(1))


def test_a_hang_ends_when_it_is_interrupted(device: IsolatedDevice) -> None:
    model = device.load("any", {})
    errors: list[DeviceError] = []

    def hang() -> None:
        try:
            model.infer(x(Doubler.HANG))
        except DeviceError as error:
            errors.append(error)

    thread = threading.Thread(target=hang)
    thread.start()
    while not device._waiting:
        pass
    device.interrupt()
    thread.join(60)
    assert "SIGKILL" in str(errors[0])


def test_interrupting_an_idle_device_leaves_it_alone(device: IsolatedDevice) -> None:
    model = device.load("any", {})
    device.interrupt()
    assert model.infer(x(1))["y"][0] == 2


@pytest.mark.parametrize(
    ("restarts", "reason"),
    [
        (Restarts("never"), "restart_policy is never"),
        (Restarts("on-failure", 0), "max_restarts"),
    ],
)
def test_a_process_that_may_not_be_restarted_says_so(restarts: Restarts, reason: str) -> None:
    device = isolated(restarts)
    try:
        with pytest.raises(DeviceError):
            device.load("any", {}).infer(x(Doubler.SEGFAULT))
        probe = device.probe()
        assert not probe.available
        assert "SIGSEGV" in probe.reason
        assert reason in probe.reason
    finally:
        device.close()


def test_closing_leaves_no_process_and_no_descriptor() -> None:
    before = descriptors()
    device = isolated()
    device.probe()
    pid = device.pid
    assert pid is not None
    device.close()
    assert not psutil.pid_exists(pid)
    assert not descriptors() - before


def test_the_process_ends_with_its_parent_even_while_it_hangs(tmp_path: Path) -> None:
    script = f"""
import os, signal, sys
sys.path[:0] = {sys.path!r}
from test_isolated import isolated, x, Doubler
import threading
device = isolated()
model = device.load("any", {{}})
threading.Thread(target=lambda: model.infer(x(Doubler.HANG)), daemon=True).start()
while not device._waiting: pass
print(device.pid, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    pid = int(done.stdout)
    with contextlib.suppress(psutil.NoSuchProcess):
        psutil.Process(pid).wait(60)  # raises where it lives on
