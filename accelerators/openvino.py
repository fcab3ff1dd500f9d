"""OpenVINO on a named device: Intel CPUs, integrated and discrete GPUs, NPUs.

The device is the one asked for, never AUTO: AUTO falls back to the CPU without a word, and falling
back is what the graph's ladder is for. Precision is explicit, because OpenVINO computes in bfloat16
on CPUs that have it, which turns 0.7 % of a segmentation's pixels into another class. Core pinning
is off: it puts the threads of two models on the same core.

A model has one request and runs it synchronously. The scheduler gives a device one run at a time,
so a second request would only wait; and an asynchronous one moves the CPU time to a thread of no
stage: FastestDet took 3.4 ms either way, of which the caller's CPU clock saw 3.4 or 0.1 ms.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np

from accelerators.intel_gpu import why_not
from pipeline.errors import DeviceError, ModelError
from pipeline.model import Model, Native, Probe, TensorSpec

#: What a device that computes in a precision lists among its capabilities.
_CAPABILITIES = {"f32": "FP32", "f16": "FP16", "bf16": "BF16"}


class OpenVino:
    """Runs OpenVINO IR (and ONNX) files on `device`: CPU, GPU, GPU.1, NPU ...

    `precision` is that of the arithmetic, whatever the file stores; one that the device does not
    have is refused. `threads` counts on the CPU only. `cache_dir` keeps compiled models between
    starts (GPUs compile for many seconds). TensorFlow Lite files are not for it, although it reads
    some: it fails on others, the Cityscapes DeepLab among them.
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
        if not re.fullmatch(r"[A-Z]+(\.\d+)?", device):
            raise ValueError(f"device {device} is no OpenVINO device; write CPU, GPU, GPU.1, NPU")
        if threads < 1:
            raise ValueError(f"threads must be at least 1, not {threads}")
        self.device = device
        self.precision = precision
        self.threads = threads
        self.cache_dir = cache_dir
        self._core: Any = None

    @classmethod
    def candidates(cls) -> Sequence[Mapping[str, Any]]:
        try:
            found = cls()._open().available_devices
        except DeviceError:
            found = []
        missing = [name for name in ("CPU", "GPU") if not _is_there(name, found)]
        return [{"device": name} for name in (*found, *missing)]

    def probe(self) -> Probe:
        try:
            core = self._open()
        except DeviceError as error:
            return Probe(False, "", "", str(error))
        runtime = f"openvino {version('openvino')}"
        if not _is_there(self.device, core.available_devices):
            found = ", ".join(core.available_devices) or "none"
            way_out = why_not() if self.device == "GPU" else "name one of these"
            reason = f"OpenVINO finds no device {self.device}, only {found}; {way_out}"
            return Probe(False, "", runtime, reason)
        name = core.get_property(self.device, "FULL_DEVICE_NAME").strip()
        has = core.get_property(self.device, "OPTIMIZATION_CAPABILITIES")
        if _CAPABILITIES[self.precision] not in has:
            can = ", ".join(key for key, value in _CAPABILITIES.items() if value in has)
            reason = f"{name} does not compute in {self.precision}; set precision to {can}"
            return Probe(False, "", runtime, reason)
        return Probe(True, name, runtime, driver=_gpu_driver(core, self.device))

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        if not (probe := self.probe()).available:
            raise DeviceError(f"{path} on {self.device}: {probe.reason}")
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
        if any(_numbered(name) != _numbered(self.device) for name in placed):
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


def write_ir(onnx: Path, xml: Path) -> None:
    """Convert an ONNX file to IR: `xml`, and a .bin of 16-bit weights beside it.

    Raises DeviceError without OpenVINO, ModelError where the file cannot be converted or written.
    """
    try:
        import openvino
    except ImportError as error:
        raise DeviceError(f"openvino does not start ({error}): pip install openvino") from error
    try:
        openvino.save_model(openvino.convert_model(onnx), xml, compress_to_fp16=True)
    except RuntimeError as error:
        raise ModelError(f"{onnx} as {xml.name}: {_first_line(error)}") from error


def operations(xml: Path) -> Sequence[Any]:
    """The operations of an IR file, inputs first, as OpenVINO's nodes; nothing is compiled.

    Raises DeviceError without OpenVINO, ModelError where the file cannot be read.
    """
    core = OpenVino()._open()
    try:
        return list(core.read_model(xml).get_ordered_ops())
    except RuntimeError as error:
        raise ModelError(f"{xml}: cannot be read ({_first_line(error)})") from error


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


def _is_there(device: str, found: Sequence[str]) -> bool:
    """Whether a device is among those that OpenVINO lists: a lone GPU has no number there."""
    return _numbered(device) in map(_numbered, found)


def _numbered(device: str) -> str:
    return device if "." in device else f"{device}.0"


def _gpu_driver(core: Any, device: str) -> str:
    """The version of the vendor's driver; a device without one has no such property."""
    try:
        return str(core.get_property(device, "GPU_DRIVER_VERSION"))
    except RuntimeError:
        return ""


def _first_line(error: Exception) -> str:
    """OpenVINO's messages carry source places; the last line is the sentence."""
    lines = [line for line in str(error).strip().splitlines() if line.strip()]
    return lines[-1].strip() if lines else type(error).__name__
