"""Accelerators that a test isolates: they live in the child process."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from pipeline.errors import DeviceError, ModelError
from pipeline.model import Model, Native, Probe, TensorSpec


class Doubler:
    """Doubles its input; an input of one of these numbers makes it fail in its own way."""

    RAISE, SEGFAULT, HANG, EXIT = 101, 102, 103, 104

    kinds: tuple[str, ...] = ("double",)

    def __init__(self, *, gain: float = 2.0) -> None:
        self.gain = gain

    def probe(self) -> Probe:
        return Probe(True, f"pid {os.getpid()}", "doubler")

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        if path == "missing":
            raise ModelError("missing: no such model")
        return Double(self.gain)

    def close(self) -> None:
        pass


class Double:
    inputs: Mapping[str, TensorSpec] = {"x": TensorSpec((4,), "float32")}
    outputs: Mapping[str, TensorSpec] = {"y": TensorSpec((4,), "float32", 0.5, 3)}

    def __init__(self, gain: float) -> None:
        self.gain = gain

    def infer(self, inputs: Native) -> Native:
        number = float(inputs["x"].flat[0])
        if number == Doubler.RAISE:
            raise DeviceError("this one fails")
        if number == Doubler.SEGFAULT:
            os.kill(os.getpid(), signal.SIGSEGV)
        if number == Doubler.HANG:
            time.sleep(60)
        if number == Doubler.EXIT:
            os._exit(3)
        return {"y": np.asarray(inputs["x"] * self.gain, np.float32)}
