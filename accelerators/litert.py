"""TensorFlow Lite models on the CPU and on Coral Edge TPUs."""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from accelerators.edgetpu_bus import attached, is_device, why_not
from accelerators.tflite_file import (
    EDGETPU_OPERATOR,
    compiled_for_edgetpu,
    cut,
    is_tflite,
    read_graph,
)
from accelerators.tflite_package import BACKENDS, Backend, Package, working_package
from pipeline.errors import DeviceError, ModelError
from pipeline.model import Model, Native, Probe, TensorSpec

log = logging.getLogger(__name__)


class TfliteCpu:
    """Runs .tflite files on the CPU.

    `threads` is the whole pool of one model. `tflite_backend` picks the package; "auto" takes the
    first that can build an interpreter, LiteRT before tflite-runtime.
    """

    kinds: tuple[str, ...] = ("tflite",)

    def __init__(self, *, threads: int = 1, tflite_backend: Backend = "auto") -> None:
        self.threads = _checked(threads)
        self.tflite_backend = tflite_backend

    @classmethod
    def candidates(cls) -> Sequence[Mapping[str, Any]]:
        return [{"tflite_backend": name} for name in BACKENDS]

    def probe(self) -> Probe:
        try:
            package = working_package(self.tflite_backend)
        except DeviceError as error:
            return Probe(False, "", "", str(error))
        return Probe(True, "CPU", package.runtime)

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        """Load a model; outputs that name a `tensor` cut it there (see `tflite_file.cut`)."""
        content = _read(path)
        if compiled_for_edgetpu(content):
            raise ModelError(
                f"{path}: is compiled for the Edge TPU and cannot run on a CPU; "
                "name the .tflite that it was compiled from in the registry"
            )
        package = working_package(self.tflite_backend)
        return _load(package, path, _as_asked(path, content, variant), self.threads)

    def close(self) -> None:
        """Nothing is held beyond the models."""


class EdgeTpu:
    """Runs files of the Edge TPU compiler on a Coral Edge TPU, through libedgetpu.

    `device` is usb, pci, or one of several: usb:0, pci:1; without it, any. `library` is libedgetpu
    where it is not on the loader's path. `threads` is for what the compiler left to the CPU.

    A file that is not compiled is refused: the delegate would take none of its operators, and the
    CPU would run them all without a word. What is left to the CPU of one that is, is logged.

    libedgetpu has to be built for the TensorFlow Lite that loads it. Google's own 16.0 goes with
    releases up to 2.11 and kills the process with later ones when a model first runs; builds for
    later releases name theirs (16.0TF2.17). So the probe shows both versions, and unless the file
    says otherwise the device has a process of its own.
    """

    kinds: tuple[str, ...] = ("edgetpu",)
    isolate = True  #: as said above

    def __init__(
        self,
        *,
        device: str | None = None,
        library: str = "libedgetpu.so.1",
        threads: int = 1,
        tflite_backend: Backend = "auto",
    ) -> None:
        if device is not None and not is_device(device):
            raise ValueError(f"device {device} is no Edge TPU; write usb, pci, usb:0 or pci:0")
        self.device = device
        self.library = library
        self.threads = _checked(threads)
        self.tflite_backend = tflite_backend

    @classmethod
    def candidates(cls) -> Sequence[Mapping[str, Any]]:
        return [{"device": one.name} for one in attached()] or [{}]

    def probe(self) -> Probe:
        """Open the device and let it go again."""
        try:
            package = working_package(self.tflite_backend)
            self._open(package)
        except DeviceError as error:
            return Probe(False, "", "", str(error))
        return Probe(
            True,
            f"Edge TPU {self.device or 'on USB or PCIe'}",
            f"{package.runtime}, {_libedgetpu_version(self.library)}",
            driver=next((one.driver for one in attached() if one.name == self.device), ""),
        )

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        """Load a compiled model; outputs that name a `tensor` cut off what the CPU would do."""
        content = _read(path)
        if not compiled_for_edgetpu(content):
            raise ModelError(
                f"{path}: is not compiled for the Edge TPU, so all of it would run on the CPU; "
                "compile it with edgetpu_compiler, or run it on a device of accelerators.litert:"
                "TfliteCpu"
            )
        package = working_package(self.tflite_backend)
        content = _as_asked(path, content, variant)
        model = _load(package, path, content, self.threads, [self._open(package)])
        every = [operation.name for operation in read_graph(content).operations]
        on_cpu = [name for name in every if name != EDGETPU_OPERATOR.decode()]
        if on_cpu:
            log.warning("%s: the CPU runs what the compiler left: %s", path, ", ".join(on_cpu))
        return model

    def close(self) -> None:
        """Nothing is held beyond the models: each has a delegate of its own."""

    def _open(self, package: Package) -> Any:
        """A delegate; raises DeviceError that tells the three ways apart in which it may fail.

        The library is tried before the delegate is made of it, because a delegate that has none
        prints a second error when it is thrown away.
        """
        try:
            library = ctypes.CDLL(self.library)
        except OSError as error:
            raise DeviceError(_library_missing(self.library, str(error))) from error
        if not hasattr(library, "tflite_plugin_create_delegate"):
            raise DeviceError(
                f"{self.library} is no TensorFlow Lite delegate; name libedgetpu under 'library'"
            )
        options = {} if self.device is None else {"device": self.device}
        try:
            return package.load_delegate(self.library, options)
        except ValueError as error:
            said = str(error).partition("\n")[2].strip()  # libedgetpu itself says nothing
            raise DeviceError(why_not(self.device) + (f" ({said})" if said else "")) from error


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


def _checked(threads: int) -> int:
    if threads < 1:
        raise ValueError(f"threads must be at least 1, not {threads}")
    return threads


def _read(path: str) -> bytes:
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror})") from None
    if not is_tflite(content):
        raise ModelError(f"{path}: is not a TensorFlow Lite model")
    return content


def _as_asked(path: str, content: bytes, variant: Mapping[str, Any]) -> bytes:
    """The file, cut where the variant's outputs name a tensor."""
    outputs = variant.get("outputs", {}).values()
    tensors = [output["tensor"] for output in outputs if output.get("tensor") is not None]
    try:
        return cut(content, tensors) if tensors else content
    except ValueError as error:
        raise ModelError(f"{path}: {error}") from error


def _load(
    package: Package, path: str, content: bytes, threads: int, delegates: Sequence[Any] = ()
) -> TfliteModel:
    try:
        interpreter = package.interpreter(
            model_content=content, num_threads=threads, experimental_delegates=list(delegates)
        )
        interpreter.allocate_tensors()
    except (ValueError, RuntimeError) as error:
        raise ModelError(f"{path}: {str(error).strip()}") from error
    return TfliteModel(interpreter, path)


def _library_missing(library: str, said: str) -> str:
    """The loader names the file that it lacks: libedgetpu itself, or one that it stands on."""
    lacks = said.partition(":")[0]
    if "No such file" not in said:
        return f"{library} cannot be loaded ({said}); install libedgetpu1-std for this machine"
    if lacks != library:
        package = "libusb-1.0-0" if lacks.startswith("libusb-1.0") else lacks
        return f"{library} needs {lacks}, which is not installed; install {package}"
    return f"{library} is not installed; install the Edge TPU runtime (libedgetpu1-std)"


def _libedgetpu_version(library: str) -> str:
    """What libedgetpu says of itself."""
    try:
        version_of = ctypes.CDLL(library).edgetpu_version
    except (AttributeError, OSError):
        return f"{library} without a version"
    version_of.restype = ctypes.c_char_p
    return f"libedgetpu {(version_of() or b'').decode(errors='replace')}"
