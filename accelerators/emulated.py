"""An emulated device: takes the time a real one would, computes nothing.

It is what the shipped emulated graph, the benchmarks of the scheduler and most tests run on. Every
name it shows says "emulated", so no figure of it can pass for a measurement of hardware.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from pipeline.errors import DeviceError, ModelError
from pipeline.model import Model, Native, Probe, TensorSpec

#: A sleep that ended later than this was not the timer's doing (the machine was busy).
MAX_LATE_S = 0.001


class Emulated:
    """Holds itself for `latency_ms[model]` +- `jitter_ms` (uniform) per infer, one model at a time.

    A sleep ends 0.1 to 0.4 ms late. The running mean of that is taken off the next ones, so that
    the device is held for the declared time in the mean; what comes later is the host's own.

    Outputs have the shape and type of the model's `emulated` variant in the registry and are zero.
    """

    kinds: tuple[str, ...] = ("emulated",)

    def __init__(
        self, *, latency_ms: Mapping[str, float], jitter_ms: float = 0.0, seed: int = 0
    ) -> None:
        if any(not ms >= 0 for ms in (*latency_ms.values(), jitter_ms)):
            raise ValueError("latency_ms and jitter_ms must not be negative")
        self.latency_ms = dict(latency_ms)
        self.jitter_ms = jitter_ms
        self._random = np.random.default_rng(seed)
        self._held = threading.Lock()
        self._late_s = 0.0  #: running mean of how late sleeps end

    def probe(self) -> Probe:
        return Probe(True, "emulated", "emulated: declared times, no computation")

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        model = variant["model"]
        if model not in self.latency_ms:
            known = ", ".join(self.latency_ms) or "none"
            raise ModelError(
                f"model '{model}': the emulated device has no latency_ms (has {known})"
            )
        return EmulatedModel(self, self.latency_ms[model], variant)

    def hold(self, latency_ms: float) -> None:
        """Occupy the device for the time of one infer."""
        with self._held:
            jitter = self._random.uniform(-self.jitter_ms, self.jitter_ms)
            end = time.monotonic() + max(0.0, latency_ms + jitter) / 1e3
            while (left := end - self._late_s - time.monotonic()) > 0:
                time.sleep(left)
            late = min(max(self._late_s + time.monotonic() - end, 0.0), MAX_LATE_S)
            self._late_s += (late - self._late_s) / 8

    def close(self) -> None:
        """Nothing is held."""


class EmulatedModel:
    """The declared shapes of a model; outputs are made once and shared, read-only."""

    def __init__(self, device: Emulated, latency_ms: float, variant: Mapping[str, Any]) -> None:
        self._device = device
        self._latency_ms = latency_ms
        image = variant["input"]
        self.inputs: Mapping[str, TensorSpec] = {
            image["name"]: TensorSpec((1, *image["shape"]), image["dtype"])
        }
        self.outputs: Mapping[str, TensorSpec] = {
            name: _spec(variant["model"], name, output)
            for name, output in variant["outputs"].items()
        }
        self._arrays = {
            name: np.zeros(spec.shape, dtype=spec.dtype) for name, spec in self.outputs.items()
        }
        for array in self._arrays.values():
            array.flags.writeable = False

    def infer(self, inputs: Native) -> Native:
        for name, spec in self.inputs.items():
            given = inputs[name]
            if given.shape != spec.shape or given.dtype != spec.dtype:
                raise DeviceError(
                    f"emulated: input '{name}' takes {spec.dtype} {spec.shape}, "
                    f"not {given.dtype} {given.shape}"
                )
        self._device.hold(self._latency_ms)
        return dict(self._arrays)


def _spec(model: str, name: str, output: Mapping[str, Any]) -> TensorSpec:
    if "shape" not in output:
        raise ModelError(f"model '{model}': the emulated output '{name}' needs a shape")
    return TensorSpec(
        tuple(output["shape"]),
        output.get("dtype", "float32"),
        output.get("scale", 0.0),
        output.get("zero_point", 0),
    )
