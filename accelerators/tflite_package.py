"""The package that runs .tflite files: LiteRT, or its predecessor tflite-runtime.

Both have the same Interpreter. LiteRT is 10 to 40 times faster on 8-bit models on x86 and runs with
every numpy; tflite-runtime is there for targets that have only it.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any, Literal, NamedTuple, get_args

from pipeline.errors import DeviceError

Backend = Literal["auto", "litert", "tflite_runtime"]
BACKENDS: tuple[str, ...] = get_args(Backend)[1:]  #: in the order in which "auto" tries them

#: A whole model: one float32 that is both input and output, no operator. The probe builds it
#: because with numpy 2 the import of tflite_runtime succeeds and only the first Interpreter fails.
_SMALLEST_MODEL = base64.b64decode(
    "GAAAAFRGTDMAAA4AFAAQAAwACAAAAAQADgAAABAAAAAcAAAAdAAAAAMAAAABAAAACAAAAAQABAAEAAAAAQAAABAA"
    "AAAMABQAEAAMAAgABAAMAAAAEAAAABAAAAAUAAAAGAAAAAAAAAABAAAAAAAAAAEAAAAAAAAAAQAAAAwAAAAAAAYA"
    "CAAEAAYAAAAEAAAAAQAAAAEAAAAAAAAA"
)


class Package(NamedTuple):
    """A package that runs .tflite files."""

    interpreter: Any
    load_delegate: Any
    runtime: str  #: its name and version


def _litert() -> tuple[Any, Any]:
    from ai_edge_litert.interpreter import Interpreter, load_delegate

    return Interpreter, load_delegate


def _tflite_runtime() -> tuple[Any, Any]:
    from tflite_runtime.interpreter import Interpreter, load_delegate

    return Interpreter, load_delegate


_PACKAGES: Mapping[str, tuple[str, Callable[[], tuple[Any, Any]], str]] = {
    "litert": ("ai-edge-litert", _litert, "pip install ai-edge-litert"),
    "tflite_runtime": (
        "tflite-runtime",
        _tflite_runtime,
        "pip install 'overflight[tflite-runtime]' on Python 3.11, which also holds numpy below 2",
    ),
}


def working_package(backend: Backend) -> Package:
    """The first package that works; raises DeviceError with the way out of each that does not."""
    reasons = []
    for key in BACKENDS if backend == "auto" else (backend,):
        name, load, remedy = _PACKAGES[key]
        try:
            interpreter, load_delegate = load()
            interpreter(model_content=_SMALLEST_MODEL).allocate_tensors()
        except Exception as error:  # a broken binary wheel raises SystemError, AttributeError, ...
            why = str(error).strip() or type(error).__name__
            reasons.append(f"{name} does not start ({why}): {remedy}")
        else:
            return Package(interpreter, load_delegate, f"{name} {version(name)}")
    raise DeviceError("; or ".join(reasons))
