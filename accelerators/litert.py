"""TensorFlow Lite models on the CPU, through LiteRT or its predecessor tflite-runtime.

Both packages have the same Interpreter. LiteRT is 10 to 40 times faster on 8-bit models on x86 and
runs with every numpy; tflite-runtime is there for targets that have only it.
"""

from __future__ import annotations

import base64
import struct
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from accelerators.tflite_file import compiled_for_edgetpu, cut, is_tflite
from pipeline.errors import DeviceError, ModelError
from pipeline.model import Model, Native, Probe, TensorSpec

Backend = Literal["auto", "litert", "tflite_runtime"]

#: A whole model: one float32 that is both input and output, no operator. The probe builds it
#: because with numpy 2 the import of tflite_runtime succeeds and only the first Interpreter fails.
_SMALLEST_MODEL = base64.b64decode(
    "GAAAAFRGTDMAAA4AFAAQAAwACAAAAAQADgAAABAAAAAcAAAAdAAAAAMAAAABAAAACAAAAAQABAAEAAAAAQAAABAA"
    "AAAMABQAEAAMAAgABAAMAAAAEAAAABAAAAAUAAAAGAAAAAAAAAABAAAAAAAAAAEAAAAAAAAAAQAAAAwAAAAAAAYA"
    "CAAEAAYAAAAEAAAAAQAAAAEAAAAAAAAA"
)


class TfliteCpu:
    """Runs .tflite files on the CPU.

    `threads` is the whole pool of one model. `tflite_backend` picks the package; "auto" takes the
    first that can build an interpreter, LiteRT before tflite-runtime.
    """

    kinds: tuple[str, ...] = ("tflite",)

    def __init__(self, *, threads: int = 1, tflite_backend: Backend = "auto") -> None:
        if threads < 1:
            raise ValueError(f"threads must be at least 1, not {threads}")
        self.threads = threads
        self.tflite_backend = tflite_backend

    def probe(self) -> Probe:
        try:
            _, runtime = _interpreter(self.tflite_backend)
        except DeviceError as error:
            return Probe(False, "", "", str(error))
        return Probe(True, "CPU", runtime)

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        """Load a model; outputs that name a `tensor` cut it there (see `tflite_file.cut`)."""
        build, _ = _interpreter(self.tflite_backend)
        try:
            content = Path(path).read_bytes()
        except OSError as error:
            raise ModelError(f"{path}: cannot be read ({error.strerror})") from None
        if not is_tflite(content):
            raise ModelError(f"{path}: is not a TensorFlow Lite model")
        if compiled_for_edgetpu(content):
            raise ModelError(
                f"{path}: is compiled for the Edge TPU and cannot run on a CPU; "
                "name the .tflite that it was compiled from in the registry"
            )
        tensors = [
            output["tensor"]
            for output in variant.get("outputs", {}).values()
            if output.get("tensor") is not None
        ]
        try:
            if tensors:
                content = cut(content, tensors)
            interpreter = build(model_content=content, num_threads=self.threads)
            interpreter.allocate_tensors()
        except (ValueError, RuntimeError, struct.error) as error:
            raise ModelError(f"{path}: {str(error).strip()}") from error
        return TfliteModel(interpreter, path)

    def close(self) -> None:
        """Nothing is held beyond the models."""


class TfliteModel:
    """One interpreter; tensors go by the names in the file."""

    def __init__(self, interpreter: Any, path: str) -> None:
        self._interpreter = interpreter
        self._path = path
        inputs, outputs = interpreter.get_input_details(), interpreter.get_output_details()
        self.inputs: Mapping[str, TensorSpec] = {one["name"]: _spec(one) for one in inputs}
        self.outputs: Mapping[str, TensorSpec] = {one["name"]: _spec(one) for one in outputs}
        self._input_numbers = {one["name"]: one["index"] for one in inputs}
        self._output_numbers = {one["name"]: one["index"] for one in outputs}

    def infer(self, inputs: Native) -> Native:
        try:
            for name, number in self._input_numbers.items():
                self._interpreter.set_tensor(number, inputs[name])
            self._interpreter.invoke()
        except (ValueError, RuntimeError) as error:
            raise DeviceError(f"{self._path}: {str(error).strip()}") from error
        return {
            name: self._interpreter.get_tensor(number)  # a copy: the next invoke overwrites
            for name, number in self._output_numbers.items()
        }


def _spec(detail: Mapping[str, Any]) -> TensorSpec:
    scale, zero_point = detail["quantization"]
    shape = tuple(int(size) for size in detail["shape"])
    return TensorSpec(shape, detail["dtype"].__name__, float(scale), int(zero_point))


def _litert() -> Any:
    from ai_edge_litert.interpreter import Interpreter

    return Interpreter


def _tflite_runtime() -> Any:
    from tflite_runtime.interpreter import Interpreter

    return Interpreter


_PACKAGES: Mapping[str, tuple[str, Callable[[], Any], str]] = {
    "litert": ("ai-edge-litert", _litert, "pip install ai-edge-litert"),
    "tflite_runtime": (
        "tflite-runtime",
        _tflite_runtime,
        "pip install 'overflight[tflite-runtime]' on Python 3.11, which also holds numpy below 2",
    ),
}


def _interpreter(backend: Backend) -> tuple[Any, str]:
    """The Interpreter class that works and its package with version; raises DeviceError."""
    reasons = []
    for name in _PACKAGES if backend == "auto" else (backend,):
        package, load, remedy = _PACKAGES[name]
        try:
            build = load()
            build(model_content=_SMALLEST_MODEL).allocate_tensors()
        except Exception as error:  # a broken binary wheel raises SystemError, AttributeError, ...
            why = str(error).strip() or type(error).__name__
            reasons.append(f"{package} does not start ({why}): {remedy}")
        else:
            return build, f"{package} {version(package)}"
    raise DeviceError("; or ".join(reasons))
