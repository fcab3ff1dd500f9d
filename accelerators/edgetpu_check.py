"""Which operations of a .tflite model an Edge TPU would run, told without its compiler.

The compiler takes one connected part of the graph from its inputs on. The first operation that the
device cannot run and everything computed from it stay on the CPU, also operations that it could.
The rules are those of Google's table of supported operations, and beyond it what the compiler did
to public models (`TAKEN_BEYOND_THE_TABLE`, `MAX_ENLARGEMENT`, `MAX_RESIZED`). It does not tell all
its reasons, so this is a prediction; it is right for every compiled model in the tests.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from accelerators.tflite_file import (
    Operation,
    TfliteGraph,
    TfliteTensor,
    compiled_for_edgetpu,
    is_tflite,
    read_graph,
)
from pipeline.errors import ModelError

#: Memory on the chip that the compiler gives to parameters; what is more is sent on every run.
PARAMETER_BYTES = 8 << 20

#: Bilinear enlargements were taken at 1 and 2 times, refused at 15.5 and 33 times ("to avoid loss
#: in precision"); where between the limit lies is not known.
MAX_ENLARGEMENT = 8.0
#: Values of a resized tensor: 128x128x32 was taken, 512x512x32 refused (google-coral/edgetpu #31);
#: where between the limit lies is not known.
MAX_RESIZED = 4 << 20
MAX_SOFTMAX = 16_000

_EIGHT_BIT = ("uint8", "int8")
#: Why the rest of the graph is not compiled, whatever it holds.
AFTER_THE_CUT = "comes after the cut, and there is only one"


@dataclass(frozen=True, slots=True)
class Placed:
    """One operation and where it would run."""

    number: int  #: in the order of execution
    name: str  #: of the schema, e.g. CONV_2D
    output: str  #: name of the tensor that it computes
    shape: tuple[int, ...]  #: of that tensor
    on_device: bool
    cuts: bool  #: the device's part ends before it, or cannot begin with it
    reason: str  #: why it stays on the CPU, else empty


@dataclass(frozen=True, slots=True)
class EdgeTpuReport:
    """What would become of a model."""

    operations: tuple[Placed, ...]
    parameter_bytes: int  #: constants of the operations on the device

    @property
    def mapped(self) -> int:
        """Operations that would run on the device."""
        return sum(placed.on_device for placed in self.operations)

    @property
    def cuts(self) -> tuple[Placed, ...]:
        """Where the graph is cut: what would have to change for more of it to be compiled."""
        return tuple(placed for placed in self.operations if placed.cuts)


def check_file(path: Path) -> EdgeTpuReport:
    """The report on a file. Raises ModelError where it is no .tflite model, or compiled already."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror})") from None
    if not is_tflite(content):
        raise ModelError(
            f"{path}: is not a TensorFlow Lite model, and an Edge TPU runs no other; "
            "convert the network to fully 8-bit .tflite"
        )
    if compiled_for_edgetpu(content):
        raise ModelError(
            f"{path}: is already compiled for the Edge TPU; check the .tflite it was compiled from"
        )
    try:
        return check_graph(read_graph(content))
    except ValueError as error:
        raise ModelError(f"{path}: {error}") from None


def check_graph(graph: TfliteGraph) -> EdgeTpuReport:
    """Where each operation of a graph would run."""
    cpu: set[int] = set()  # tensors from which nothing on the device may be computed
    placed = []
    for number, operation in enumerate(graph.operations):
        reason = _reason(operation, graph)
        after = any(tensor in cpu for tensor in operation.inputs)
        begins = _quantizes_input(operation, graph)
        fits = not reason and not after
        if not fits and not begins:
            cpu.update(operation.outputs)
        output = graph.tensors[operation.outputs[0]] if operation.outputs else None
        placed.append(
            Placed(
                number,
                operation.name,
                output.name if output else "",
                output.spec.shape if output else (),
                on_device=fits,
                cuts=not fits and not after and not begins,
                reason=reason or (AFTER_THE_CUT if after else ""),
            )
        )
    constants = {
        tensor
        for operation, place in zip(graph.operations, placed, strict=True)
        if place.on_device
        for tensor in operation.inputs
        if tensor >= 0
    }
    size = sum(len(graph.tensors[tensor].content or b"") for tensor in constants)
    return EdgeTpuReport(tuple(placed), size)


def _quantizes_input(operation: Operation, graph: TfliteGraph) -> bool:
    """Turning a float input into 8 bits stays on the CPU, and the device's part begins after it."""
    return operation.name == "QUANTIZE" and set(operation.inputs) <= set(graph.inputs)


@dataclass(frozen=True, slots=True)
class _Case:
    """An operation with its tensors at hand, for the rules."""

    operation: Operation
    inputs: tuple[TfliteTensor, ...]
    output: TfliteTensor

    def option(self, field: int, form: str = "b", default: int = 0) -> int:
        options = self.operation.options
        return default if options is None else int(options.number(field, form, default))

    def integers(self, number: int) -> list[int]:
        """The values of a constant int32 input; empty where it is none."""
        if number >= len(self.inputs):
            return []
        content = self.inputs[number].content
        return [] if content is None else np.frombuffer(content, np.int32).tolist()


Rule = Callable[[_Case], str]  #: the reason against the operation, empty where there is none


def _reason(operation: Operation, graph: TfliteGraph) -> str:
    """Why an operation cannot run on the device, whatever comes before it; empty where it can."""
    if operation.name not in RULES or not operation.outputs:
        return "is not an operation of the Edge TPU"
    inputs = tuple(graph.tensors[number] for number in operation.inputs if number >= 0)
    computed = [tensor for tensor in inputs if tensor.content is None]
    outputs = [graph.tensors[number] for number in operation.outputs]
    for tensor in (*computed, *outputs):
        if tensor.spec.dtype not in _EIGHT_BIT:
            return f"works on {tensor.spec.dtype}, not on 8-bit integers ('{tensor.name}')"
        if not tensor.fixed:
            return f"has an open size ('{tensor.name}'); fix it when converting"
        if math.prod(tensor.spec.shape[:-3]) > 1:
            shape = "x".join(map(str, tensor.spec.shape))
            return f"works on {shape}; only the three innermost sizes may be above 1"
    return RULES[operation.name](_Case(operation, inputs, outputs[0]))


def _always(case: _Case) -> str:
    return ""


def _convolution(case: _Case, dilation: int = 4) -> str:
    if any(tensor.content is None for tensor in case.inputs[1:]):
        return "has weights that are computed; they have to be constants"
    if case.option(dilation, "i", 1) != case.option(dilation + 1, "i", 1):
        return "is dilated differently in x and y"
    return ""


def _depthwise(case: _Case) -> str:
    return _convolution(case, dilation=5)


def _no_activation(field: int) -> Rule:
    return lambda case: "has a fused activation" if case.option(field) else ""


def _concatenation(case: _Case) -> str:
    constants = [tensor for tensor in case.inputs if tensor.content is not None]
    if constants and (len(case.inputs) != 2 or any(any(c.content or b"") for c in constants)):
        return "joins a constant that is not a padding of zeros"
    return _no_activation(1)(case)


def _fully_connected(case: _Case) -> str:
    if case.inputs[1].content is None:
        return "has weights that are computed; they have to be constants"
    if math.prod(case.output.spec.shape[:-1]) > 1:
        return "has an output of more than one dimension"
    return "has shuffled weights" if case.option(1) else ""


def _keeps_batch(case: _Case) -> str:
    """Reductions: the batch must stay, and over the channels only in multiples of 4."""
    rank = len(case.inputs[0].spec.shape)
    axes = {axis % rank for axis in case.integers(1)}
    if rank == 4 and 0 in axes:
        return "reduces over the batch"
    if case.operation.name == "MEAN" and rank - 1 in axes and case.inputs[0].spec.shape[-1] % 4:
        return "takes the mean of channels that are no multiple of 4"
    return ""


def _pad(case: _Case) -> str:
    padded = case.integers(1)
    return "pads the batch" if len(padded) == 8 and any(padded[:2]) else ""


def _pack(case: _Case) -> str:
    axis = case.option(1, "i") % len(case.output.spec.shape)
    return "packs along the batch" if axis == 0 and len(case.output.spec.shape) > 3 else ""


def _prelu(case: _Case) -> str:
    alpha = case.inputs[1].spec.shape
    return "has slopes by place, not by channel alone" if math.prod(alpha[:-1]) > 1 else ""


def _resize(case: _Case) -> str:
    before, after = case.inputs[0].spec.shape, case.output.spec.shape
    factor = max(after[axis] / before[axis] for axis in (1, 2))
    if factor > MAX_ENLARGEMENT:
        return f"enlarges {factor:.3g} times, which the compiler refuses to avoid loss in precision"
    if math.prod(after) > MAX_RESIZED:
        return f"makes {math.prod(after):,} values, which the compiler refuses as too many"
    return ""


def _softmax(case: _Case) -> str:
    shape = case.inputs[0].spec.shape
    if math.prod(shape[:-1]) > 1:
        return "works on more than one dimension"
    return f"works on more than {MAX_SOFTMAX:,} values" if shape[-1] > MAX_SOFTMAX else ""


def _squeeze(case: _Case) -> str:
    before, after = case.inputs[0].spec.shape, case.output.spec.shape
    leading = before[: len(before) - len(after)]
    return "" if math.prod(leading) == 1 else "drops sizes that are not the leading ones"


def _strided_slice(case: _Case) -> str:
    if any(step != 1 for step in case.integers(3)):
        return "has a stride other than 1"
    if case.option(2, "i") or case.option(3, "i"):
        return "has an ellipsis or a new axis"
    return ""


#: Operations that the compiler was seen to take, though the table does not name them: TILE in the
#: public Cityscapes DeepLab, TRANSPOSE in its logs of YOLO networks.
TAKEN_BEYOND_THE_TABLE = ("TILE", "TRANSPOSE")

_UNLIMITED = (
    *("ADD", "EXPAND_DIMS", "L2_NORMALIZATION", "LOGISTIC", "MAXIMUM", "MINIMUM"),
    *("MUL", "QUANTIZE", "RELU", "RELU6", "RELU_N1_TO_1", "RESHAPE", "RSQRT", "SLICE"),
    *("SPACE_TO_DEPTH", "SPLIT", "SQUARED_DIFFERENCE", "SUB", "TANH"),
    *("TRANSPOSE_CONV", "UNIDIRECTIONAL_SEQUENCE_LSTM"),
    *TAKEN_BEYOND_THE_TABLE,
)

#: Google's table of supported operations, with its limits.
RULES: Mapping[str, Rule] = {
    **dict.fromkeys(_UNLIMITED, _always),
    **dict.fromkeys(("AVERAGE_POOL_2D", "MAX_POOL_2D"), _no_activation(5)),
    **dict.fromkeys(("MEAN", "REDUCE_MAX", "REDUCE_MIN", "SUM"), _keeps_batch),
    **dict.fromkeys(("RESIZE_BILINEAR", "RESIZE_NEAREST_NEIGHBOR"), _resize),
    "CONCATENATION": _concatenation,
    "CONV_2D": _convolution,
    "DEPTHWISE_CONV_2D": _depthwise,
    "FULLY_CONNECTED": _fully_connected,
    "PACK": _pack,
    "PAD": _pad,
    "PRELU": _prelu,
    "SOFTMAX": _softmax,
    "SQUEEZE": _squeeze,
    "STRIDED_SLICE": _strided_slice,
}
