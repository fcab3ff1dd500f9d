"""OpenVINO on a named device: Intel CPUs, integrated and discrete GPUs, NPUs.

The device is the one asked for, never AUTO: AUTO falls back to the CPU without a word, and falling
back is what the graph's ladder is for. Precision is explicit, because OpenVINO computes in bfloat16
on CPUs that have it, which turns 0.7 % of a segmentation's pixels into another class. Core pinning
is off: it puts the threads of two models on the same core.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pipeline.errors import DeviceError, ModelError
from pipeline.model import Model, Native, Probe, TensorSpec


class OpenVino:
    """Runs OpenVINO IR (and ONNX) files on `device`: CPU, GPU, GPU.1, NPU ...

    `precision` is that of the arithmetic, whatever the file stores. `threads` counts on the CPU
    only. `cache_dir` keeps compiled models between starts (GPUs compile for many seconds).
    """

    kinds: tuple[str, ...] = ("openvino", "onnx")

    def __init__(
        self,
        *,
        device: str = "CPU",
        precision: Literal["f32", "f16", "bf16"] = "f32",
        threads: int = 1,
        cache_dir: Path | None = None,
    ) -> None:
        if device.split(":")[0].split(".")[0] in ("AUTO", "MULTI", "HETERO", "BATCH"):
            raise ValueError(f"device {device} picks by itself; name one device, e.g. CPU or GPU")
        if threads < 1:
            raise ValueError(f"threads must be at least 1, not {threads}")
        self.device = device
        self.precision = precision
        self.threads = threads
        self.cache_dir = cache_dir
        self._core: Any = None

    def probe(self) -> Probe:
        try:
            core = self._open()
        except DeviceError as error:
            return Probe(False, "", "", str(error))
        runtime = f"openvino {_version()}"
        found = core.available_devices
        if not any(name == self.device or name.split(".")[0] == self.device for name in found):
            return Probe(
                False,
                "",
                runtime,
                f"OpenVINO finds no device {self.device}, only {', '.join(found) or 'none'}; "
                "install its driver or name another device",
            )
        return Probe(True, core.get_property(self.device, "FULL_DEVICE_NAME").strip(), runtime)

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        core = self._open()
        if not Path(path).is_file():
            raise ModelError(f"{path}: no such file")
        try:
            weights = variant.get("weights")
            graph = core.read_model(path, weights) if weights else core.read_model(path)
        except RuntimeError as error:
            raise ModelError(f"{path}: {_first_line(error)}") from error
        try:
            compiled = core.compile_model(graph, self.device, self._settings())
        except RuntimeError as error:
            raise DeviceError(f"{path} on {self.device}: {_first_line(error)}") from error
        placed = list(compiled.get_property("EXECUTION_DEVICES"))
        if any(name.split(".")[0] != self.device.split(".")[0] for name in placed):
            raise DeviceError(f"{path}: asked for {self.device}, OpenVINO runs it on {placed}")
        return OpenVinoModel(compiled, path)

    def close(self) -> None:
        self._core = None

    def _settings(self) -> dict[str, Any]:
        settings: dict[str, Any] = {
            "PERFORMANCE_HINT": "LATENCY",
            "INFERENCE_PRECISION_HINT": self.precision,
        }
        if self.device == "CPU":
            settings |= {"INFERENCE_NUM_THREADS": self.threads, "ENABLE_CPU_PINNING": False}
        if self.cache_dir:
            settings["CACHE_DIR"] = str(self.cache_dir)
        return settings

    def _open(self) -> Any:
        if self._core is None:
            try:
                import openvino
            except ImportError as error:
                raise DeviceError(
                    f"openvino does not start ({error}): pip install openvino"
                ) from error
            self._core = openvino.Core()
        return self._core


class OpenVinoModel:
    """A compiled model with one infer request."""

    def __init__(self, compiled: Any, path: str) -> None:
        self._request = compiled.create_infer_request()
        self._path = path
        self.inputs: Mapping[str, TensorSpec] = _specs(compiled.inputs)
        self.outputs: Mapping[str, TensorSpec] = _specs(compiled.outputs)

    def infer(self, inputs: Native) -> Native:
        for name, spec in self.inputs.items():
            # OpenVINO would cast silently, and read a wrong image as a dark one.
            if inputs[name].dtype != spec.dtype:
                raise DeviceError(
                    f"{self._path}: input '{name}' takes {spec.dtype}, not {inputs[name].dtype}"
                )
        try:
            found = self._request.infer([inputs[name] for name in self.inputs], share_inputs=True)
        except RuntimeError as error:
            raise DeviceError(f"{self._path}: {_first_line(error)}") from error
        return {name: np.array(found[i]) for i, name in enumerate(self.outputs)}


def _specs(ports: Any) -> Mapping[str, TensorSpec]:
    return {
        port.get_any_name(): TensorSpec(
            tuple(
                -1 if size.is_dynamic else size.get_length() for size in port.get_partial_shape()
            ),
            np.dtype(port.get_element_type().to_dtype()).name,
        )
        for port in ports
    }


def _version() -> str:
    from importlib.metadata import version

    return version("openvino")


def _first_line(error: Exception) -> str:
    """OpenVINO's messages carry source places; the last line is the sentence."""
    lines = [line for line in str(error).strip().splitlines() if line.strip()]
    return lines[-1].strip() if lines else type(error).__name__
