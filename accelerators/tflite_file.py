"""Read and cut .tflite files without a runtime: what is in them, and only the part asked for.

A .tflite file is a FlatBuffer, identifier ``TFL3``. Only the few fields that we need are read, by
their numbers in the public schema.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from accelerators.flatbuffer import Table
from pipeline.model import TensorSpec

#: The operator that the Edge TPU compiler leaves in place of what it compiled.
EDGETPU_OPERATOR = b"edgetpu-custom-op"

#: Of TensorType, by number; the rest are types that no network of ours has at its ends.
_DTYPES = ("float32", "float16", "int32", "uint8", "int64", "string", "bool", "int16", "", "int8")
_CUSTOM = 32
#: Of BuiltinOperator, by number: what a vision network may be made of. Others are "OPERATOR_n".
# fmt: off
_OPERATIONS = (
    "ADD", "AVERAGE_POOL_2D", "CONCATENATION", "CONV_2D", "DEPTHWISE_CONV_2D", "DEPTH_TO_SPACE",
    "DEQUANTIZE", "EMBEDDING_LOOKUP", "FLOOR", "FULLY_CONNECTED", "HASHTABLE_LOOKUP",
    "L2_NORMALIZATION", "L2_POOL_2D", "LOCAL_RESPONSE_NORMALIZATION", "LOGISTIC",
    "LSH_PROJECTION", "LSTM", "MAX_POOL_2D", "MUL", "RELU", "RELU_N1_TO_1", "RELU6", "RESHAPE",
    "RESIZE_BILINEAR", "RNN", "SOFTMAX", "SPACE_TO_DEPTH", "SVDF", "TANH", "CONCAT_EMBEDDINGS",
    "SKIP_GRAM", "CALL", "CUSTOM", "EMBEDDING_LOOKUP_SPARSE", "PAD",
    "UNIDIRECTIONAL_SEQUENCE_RNN", "GATHER", "BATCH_TO_SPACE_ND", "SPACE_TO_BATCH_ND",
    "TRANSPOSE", "MEAN", "SUB", "DIV", "SQUEEZE", "UNIDIRECTIONAL_SEQUENCE_LSTM", "STRIDED_SLICE",
    "BIDIRECTIONAL_SEQUENCE_RNN", "EXP", "TOPK_V2", "SPLIT", "LOG_SOFTMAX", "DELEGATE",
    "BIDIRECTIONAL_SEQUENCE_LSTM", "CAST", "PRELU", "MAXIMUM", "ARG_MAX", "MINIMUM", "LESS",
    "NEG", "PADV2", "GREATER", "GREATER_EQUAL", "LESS_EQUAL", "SELECT", "SLICE", "SIN",
    "TRANSPOSE_CONV", "SPARSE_TO_DENSE", "TILE", "EXPAND_DIMS", "EQUAL", "NOT_EQUAL", "LOG",
    "SUM", "SQRT", "RSQRT", "SHAPE", "POW", "ARG_MIN", "FAKE_QUANT", "REDUCE_PROD", "REDUCE_MAX",
    "PACK", "LOGICAL_OR", "ONE_HOT", "LOGICAL_AND", "LOGICAL_NOT", "UNPACK", "REDUCE_MIN",
    "FLOOR_DIV", "REDUCE_ANY", "SQUARE", "ZEROS_LIKE", "FILL", "FLOOR_MOD", "RANGE",
    "RESIZE_NEAREST_NEIGHBOR", "LEAKY_RELU", "SQUARED_DIFFERENCE", "MIRROR_PAD", "ABS", "SPLIT_V",
    "UNIQUE", "CEIL", "REVERSE_V2", "ADD_N", "GATHER_ND", "COS", "WHERE", "RANK", "ELU",
    "REVERSE_SEQUENCE", "MATRIX_DIAG", "QUANTIZE", "MATRIX_SET_DIAG", "ROUND", "HARD_SWISH",
)
# fmt: on


@dataclass(frozen=True, slots=True)
class TfliteTensor:
    """A tensor of the main graph."""

    name: str
    spec: TensorSpec  #: as an interpreter states it: an open dimension is 1
    fixed: bool  #: no dimension is open
    content: bytes | None  #: what a constant holds; None where the network computes it


@dataclass(frozen=True, slots=True)
class Operation:
    """One operation of the main graph, in the order of execution."""

    name: str  #: of the schema, e.g. CONV_2D; a custom one by its own name
    inputs: tuple[int, ...]  #: numbers of tensors; -1 for one that is left out
    outputs: tuple[int, ...]
    options: Table | None


@dataclass(frozen=True, slots=True)
class TfliteGraph:
    """The main graph of a file."""

    tensors: tuple[TfliteTensor, ...]
    operations: tuple[Operation, ...]
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]


def is_tflite(content: bytes) -> bool:
    """Whether the bytes are a TensorFlow Lite model."""
    return content[4:8] == b"TFL3"


def compiled_for_edgetpu(content: bytes) -> bool:
    """Whether the model runs on an Edge TPU only."""
    return EDGETPU_OPERATOR in content


def read_graph(content: bytes) -> TfliteGraph:
    """The main graph of a model. Raises ValueError where the file is damaged."""
    model = Table.root(content)
    graph = _main_graph(model)
    codes = [_operation_name(code) for code in model.tables(1)]
    buffers = list(model.tables(4))
    try:
        tensors = tuple(_tensor(table, buffers) for table in graph.tables(0))
        operations = tuple(
            Operation(codes[one.number(0, "I")], one.numbers(1), one.numbers(2), one.table(4))
            for one in graph.tables(3)
        )
    except IndexError:
        raise ValueError("the file names an operator or a buffer that it does not have") from None
    ends = (graph.numbers(1), graph.numbers(2))
    named = {n for one in operations for n in (*one.inputs, *one.outputs)}.union(*ends)
    if not all(-1 <= number < len(tensors) for number in named):
        raise ValueError("the file names a tensor that it does not have")
    return TfliteGraph(tensors, operations, *ends)


def cut(content: bytes, tensors: Sequence[int]) -> bytes:
    """The model with these tensors (numbers in its main graph) as its outputs, in this order.

    Operators that come after the last one needed are taken off, so they cost nothing: operators are
    stored in the order of execution. Raises ValueError where a tensor is computed by no operator or
    the file has fewer outputs than are asked for.
    """
    model = bytearray(content)
    graph = _main_graph(Table.root(model))
    made = [operator.numbers(2) for operator in graph.tables(3)]
    last = -1
    for tensor in tensors:
        makers = [number for number, outputs in enumerate(made) if tensor in outputs]
        if not makers:
            raise ValueError(f"no operator computes tensor {tensor}")
        last = max(last, *makers)
    start, count = graph.vector(2)
    if len(tensors) > count:
        raise ValueError(f"the file has {count} outputs, {len(tensors)} tensors are asked for")
    struct.pack_into(f"<I{len(tensors)}i", model, start - 4, len(tensors), *tensors)
    start, _ = graph.vector(3)
    struct.pack_into("<I", model, start - 4, last + 1)
    return bytes(model)


def _main_graph(model: Table) -> Table:
    graph = next(model.tables(2), None)
    if graph is None:
        raise ValueError("the file holds no graph")
    return graph


def _operation_name(code: Table) -> str:
    # Numbers above 126 are in the newer field only, older files have only the other.
    number = max(code.number(0, "b"), code.number(3, "i"))
    if number == _CUSTOM:
        return code.text(1)
    return _OPERATIONS[number] if number < len(_OPERATIONS) else f"OPERATOR_{number}"


def _tensor(table: Table, buffers: Sequence[Table]) -> TfliteTensor:
    shape, dtype = table.numbers(0), table.number(1, "b")
    quantization = table.table(4)
    scales = quantization.numbers(2, "f") if quantization else ()
    zero_points = quantization.numbers(3, "q") if quantization else ()
    start, size = buffers[table.number(2, "I")].vector(0)
    # One scale for the whole tensor; weights may have one per channel, which no end of ours has.
    scale, zero_point = (
        (scales[0], zero_points[0]) if len(scales) == len(zero_points) == 1 else (0.0, 0)
    )
    name = _DTYPES[dtype] if dtype < len(_DTYPES) else ""
    return TfliteTensor(
        table.text(3),
        TensorSpec(shape, name or f"type {dtype}", scale, zero_point),
        -1 not in table.numbers(7),
        bytes(table.data[start : start + size]) if size else None,
    )
