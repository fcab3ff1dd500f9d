"""An emulated device: takes the time a real one would, and fails as it might.

It is what the shipped emulated graph, the benchmarks of the scheduler and most tests run on. Every
name it shows says "emulated", so no figure of it can pass for a measurement of hardware.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from accelerators.faults import Fault, Faults, FaultSchedule
from accelerators.latencies import column
from accelerators.zeros import Zeros
from pipeline.errors import DeviceError, ModelError
from pipeline.model import Accelerator, Model, Native, Probe

log = logging.getLogger(__name__)

#: A sleep that ended later than this was not the timer's doing (the machine was busy).
MAX_LATE_S = 0.001


class Emulated:
    """Holds itself for a declared time per run, one model at a time.

    `latency_ms` declares it by model; `latencies` names a column of the shipped tables, as
    paper.edgetpu, for the models that are not in it. `jitter_ms` is uniform, to both sides.
    `reload_ms` by model comes on top where another model ran before: its weights go to the device
    anew.

    Without `outputs` the results are zeros in the shape of the model's `emulated` variant.
    `outputs` is a device block (`{use: ..., ...}`) that computes them: the real network on the CPU,
    or the answers of a recorded run (accelerators.recorded). A run then takes the longer of the
    declared and the real time, and those that the real time made longer are logged.

    `faults` says when it dies, returns, hangs or raises; `seed` draws the jitter and the faults.

    A sleep ends 0.1 to 0.4 ms late. The running mean of that is taken off the next ones, so that
    the device is held for the declared time in the mean; what comes later is the host's own.
    """

    kinds: tuple[str, ...] = ("emulated",)

    def __init__(
        self,
        *,
        latency_ms: Mapping[str, float] | None = None,
        latencies: str | None = None,
        jitter_ms: float = 0.0,
        reload_ms: Mapping[str, float] | None = None,
        outputs: Accelerator | None = None,
        faults: Faults | None = None,
        seed: int = 0,
    ) -> None:
        shipped = {} if latencies is None else column(latencies)
        self.latency_ms = {**shipped, **(latency_ms or {})}
        self.reload_ms = dict(reload_ms or {})
        for name, values in (
            ("latency_ms", self.latency_ms.values()),
            ("jitter_ms", (jitter_ms,)),
            ("reload_ms", self.reload_ms.values()),
        ):
            if not all(ms >= 0 for ms in values):
                raise ValueError(f"{name} must not be negative")
        self.jitter_ms = jitter_ms
        self.outputs = outputs
        if outputs is not None:
            self.kinds = outputs.kinds
        self._random = np.random.default_rng(seed)
        self._faults = FaultSchedule(faults, seed) if faults else None
        self._hangs_for_s = faults.hangs_for_s if faults else None
        self._first_run: float | None = None  #: when the time of the faults began
        self._held = threading.Lock()
        self._closed = threading.Event()  #: ends a hang
        self._hanging = False
        self._last = ""  #: the model whose weights are on the device
        self._late_s = 0.0  #: running mean of how late sleeps end
        self._runs: Counter[str] = Counter()
        self._slow: Counter[str] = Counter()  #: runs that took longer than declared
        self._worst_ms: dict[str, float] = {}

    def probe(self) -> Probe:
        if self._faults and self._faults.dead(self._fault_time()):
            return Probe(False, "", "", "the emulated device died, as its faults say")
        if self._hanging:
            return Probe(False, "", "", "the emulated device hangs, as its faults say")
        if self.outputs is None:
            return Probe(True, "emulated", "emulated: declared times, outputs are zeros")
        real = self.outputs.probe()
        if not real.available:
            return Probe(False, "", "", f"emulated, and its outputs: {real.reason}")
        runtime = f"emulated: declared times, outputs by {real.runtime} on {real.name}"
        return Probe(True, f"emulated ({real.name})", runtime)

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        name = variant["model"]
        if name not in self.latency_ms:
            known = ", ".join(self.latency_ms) or "none"
            raise ModelError(f"model '{name}': the emulated device has no latency_ms (has {known})")
        real = Zeros(variant) if self.outputs is None else self.outputs.load(path, variant)
        return EmulatedModel(self, name, real)

    def run(self, name: str, compute: Callable[[], Native], *, warm: bool) -> Native:
        """One run of a model on the device: its fault, its outputs, its time."""
        with self._held:
            start = time.monotonic()
            if warm:
                self._fail()
            outputs = compute()
            took_ms = (time.monotonic() - start) * 1e3
            declared_ms = self._declared(name)
            if warm:
                self._note(name, took_ms, declared_ms)
            self._sleep_until(start + declared_ms / 1e3)
            return outputs

    def close(self) -> None:
        """End a hang, say which runs were slower than declared, close what computes the outputs."""
        self._closed.set()
        self._closed = threading.Event()
        for name, worst_ms in list(self._worst_ms.items()):
            text = "emulated: %d of %d runs of '%s' were slower than declared, at worst %.1f ms"
            log.warning(text, self._slow[name], self._runs[name], name, worst_ms)
        self._worst_ms.clear()
        if self.outputs is not None:
            self.outputs.close()

    def _note(self, name: str, took_ms: float, declared_ms: float) -> None:
        """Count a run; log the first of a model that really took longer than declared."""
        self._runs[name] += 1
        if took_ms <= declared_ms:
            return
        if name not in self._worst_ms:
            text = "emulated: the outputs of '%s' took %.1f ms here, longer than the declared %.1f"
            log.warning(text, name, took_ms, self.latency_ms[name])
        self._slow[name] += 1
        self._worst_ms[name] = max(took_ms, self._worst_ms.get(name, 0.0))

    def _declared(self, name: str) -> float:
        jitter = self._random.uniform(-self.jitter_ms, self.jitter_ms)
        reload = self.reload_ms.get(name, 0.0) if self._last not in ("", name) else 0.0
        self._last = name
        return max(0.0, self.latency_ms[name] + reload + jitter)

    def _sleep_until(self, end: float) -> None:
        if end - self._late_s <= time.monotonic():
            return
        while (left := end - self._late_s - time.monotonic()) > 0:
            time.sleep(left)
        late = min(max(self._late_s + time.monotonic() - end, 0.0), MAX_LATE_S)
        self._late_s += (late - self._late_s) / 8

    def _fail(self) -> None:
        """Do what the faults say of this run. Raises DeviceError."""
        if self._faults is None:
            return
        if self._first_run is None:
            self._first_run = time.monotonic()
        fault = self._faults.next_run(self._fault_time())
        if fault is Fault.DEAD:
            raise DeviceError("the emulated device died, as its faults say")
        if fault is Fault.RAISES:
            raise DeviceError("the emulated device failed this run, as its faults say")
        if fault is Fault.HANGS:
            self._hanging = True
            closed = self._closed.wait(self._hangs_for_s)
            self._hanging = False
            if closed:
                raise DeviceError("the emulated device was closed while it hung")

    def _fault_time(self) -> float:
        return 0.0 if self._first_run is None else time.monotonic() - self._first_run


class EmulatedModel:
    """A model whose outputs come from `real`, in the time of the emulated device.

    Its first run warms up and does not count: no fault strikes it, and it may be slow.
    """

    def __init__(self, device: Emulated, name: str, real: Model) -> None:
        self.inputs = real.inputs
        self.outputs = real.outputs
        self._device = device
        self._name = name
        self._real = real
        self._warm = False

    def infer(self, inputs: Native) -> Native:
        warm, self._warm = self._warm, True
        return self._device.run(self._name, lambda: self._real.infer(inputs), warm=warm)
