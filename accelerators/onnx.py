"""ONNX Runtime on the CPU, and on what else its build can use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.errors import DeviceError, ModelError
from pipeline.model import Model, Native, Probe, TensorSpec

_SUFFIX = "ExecutionProvider"
_DTYPES = {
    "tensor(float)": "float32",
    "tensor(float16)": "float16",
    "tensor(double)": "float64",
    "tensor(uint8)": "uint8",
    "tensor(int8)": "int8",
    "tensor(int32)": "int32",
    "tensor(int64)": "int64",
}


class Onnx:
    """Runs .onnx files with `threads` threads per model, on the CPU or what `provider` names: CUDA,
    Tensorrt, OpenVINO ... of a runtime that was built with it.

    A model of which the provider cannot run every node is refused: ONNX Runtime would give the rest
    to the CPU, or all of it, with no more than a warning.
    """

    kinds: tuple[str, ...] = ("onnx",)

    def __init__(self, *, threads: int = 1, provider: str = "CPU") -> None:
        if threads < 1:
            raise ValueError(f"threads must be at least 1, not {threads}")
        self.threads = threads
        self.provider = provider

    @classmethod
    def candidates(cls) -> Sequence[Mapping[str, Any]]:
        try:
            found = _providers(_runtime())
        except DeviceError:
            found = ["CPU"]
        return [{"provider": name} for name in found if name != "Azure"]  # that one is no device

    def probe(self) -> Probe:
        try:
            runtime = _runtime()
        except DeviceError as error:
            return Probe(False, "", "", str(error))
        found, version = _providers(runtime), f"onnxruntime {runtime.__version__}"
        if self.provider in found:
            return Probe(True, self.provider, version)
        reason = f"this onnxruntime has no provider {self.provider}, only {', '.join(found)}"
        return Probe(False, "", version, f"{reason}; install its build for {self.provider}")

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        runtime = _runtime()
        if not (probe := self.probe()).available:
            raise DeviceError(f"{path}: {probe.reason}")
        if not Path(path).is_file():
            raise ModelError(f"{path}: no such file")
        runtime.set_default_logger_severity(4)  # as of the session, below; a reader's words
        options = runtime.SessionOptions()
        options.intra_op_num_threads = self.threads
        options.inter_op_num_threads = 1
        options.log_severity_level = 4  # what matters is raised
        # A spinning pool waits for the next frame at full load: at 10 Hz with two threads 60
        # instead of 30 CPU ms per inference.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        if self.provider != "CPU":
            options.add_session_config_entry("session.disable_cpu_ep_fallback", "1")
        asked = self.provider + _SUFFIX
        try:
            session = runtime.InferenceSession(path, options, providers=[asked])
        except Exception as error:  # its exceptions have no common base but Exception
            raise ModelError(f"{path} on {self.provider}: {str(error).strip()}") from error
        if session.get_providers()[0] != asked:
            raise DeviceError(f"{path}: asked for {asked}, got {session.get_providers()}")
        return OnnxModel(session, path)

    def close(self) -> None:
        """Nothing is held beyond the models."""


class OnnxModel:
    """One session."""

    def __init__(self, session: Any, path: str) -> None:
        self._session = session
        self._path = path
        self.inputs: Mapping[str, TensorSpec] = _specs(session.get_inputs())
        self.outputs: Mapping[str, TensorSpec] = _specs(session.get_outputs())

    def infer(self, inputs: Native) -> Native:
        try:
            found = self._session.run(None, dict(inputs))
        except Exception as error:  # as above
            raise DeviceError(f"{self._path}: {str(error).strip()}") from error
        return dict(zip(self.outputs, found, strict=True))


def _specs(nodes: Any) -> Mapping[str, TensorSpec]:
    return {
        node.name: TensorSpec(
            tuple(size if isinstance(size, int) else -1 for size in node.shape),
            _DTYPES.get(node.type, node.type),
        )
        for node in nodes
    }


def _providers(runtime: Any) -> list[str]:
    return [name.removesuffix(_SUFFIX) for name in runtime.get_available_providers()]


def _runtime() -> Any:
    try:
        import onnxruntime
    except ImportError as error:
        raise DeviceError(
            f"onnxruntime does not start ({error}): pip install onnxruntime"
        ) from error
    return onnxruntime
