"""Read and cut .tflite files without a runtime: what a device may run, and only the part asked for.

A .tflite file is a FlatBuffer, identifier ``TFL3``: tables whose fields are found through a vtable.
Only the few fields that the cut needs are read, by their numbers in the public schema.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

#: The operator that the Edge TPU compiler leaves in place of what it compiled.
EDGETPU_OPERATOR = b"edgetpu-custom-op"

# Field numbers: Model.subgraphs, SubGraph.outputs, SubGraph.operators, Operator.outputs.
_SUBGRAPHS, _OUTPUTS, _OPERATORS, _OPERATOR_OUTPUTS = 2, 2, 3, 2


def is_tflite(content: bytes) -> bool:
    """Whether the bytes are a TensorFlow Lite model."""
    return content[4:8] == b"TFL3"


def compiled_for_edgetpu(content: bytes) -> bool:
    """Whether the model runs on an Edge TPU only."""
    return EDGETPU_OPERATOR in content


def cut(content: bytes, tensors: Sequence[int]) -> bytes:
    """The model with these tensors (numbers in its main graph) as its outputs, in this order.

    Operators that come after the last one needed are taken off, so they cost nothing: operators are
    stored in the order of execution. Raises ValueError where a tensor is computed by no operator or
    the file has fewer outputs than are asked for.
    """
    model = bytearray(content)
    graph = _vector(model, _table(model, 0), _SUBGRAPHS)[0]
    graph = _table(model, graph)
    operators = _vector(model, graph, _OPERATORS)
    last = -1
    for tensor in tensors:
        makers = [
            number
            for number, operator in enumerate(operators)
            if tensor in _scalars(model, _table(model, operator), _OPERATOR_OUTPUTS)
        ]
        if not makers:
            raise ValueError(f"no operator computes tensor {tensor}")
        last = max(last, *makers)
    outputs = _field(model, graph, _OUTPUTS)
    start, count = _start(model, outputs)
    if len(tensors) > count:
        raise ValueError(f"the file has {count} outputs, {len(tensors)} tensors are asked for")
    struct.pack_into(f"<I{len(tensors)}i", model, start - 4, len(tensors), *tensors)
    start, _ = _start(model, _field(model, graph, _OPERATORS))
    struct.pack_into("<I", model, start - 4, last + 1)
    return bytes(model)


def _u32(model: bytearray, at: int) -> int:
    return int(struct.unpack_from("<I", model, at)[0])


def _table(model: bytearray, at: int) -> int:
    """The table that the offset at `at` points to."""
    return at + _u32(model, at)


def _field(model: bytearray, table: int, number: int) -> int:
    """Where field `number` of a table is stored; raises ValueError where the file leaves it out."""
    vtable = table - struct.unpack_from("<i", model, table)[0]
    size = struct.unpack_from("<H", model, vtable)[0]
    slot = 4 + 2 * number
    offset = struct.unpack_from("<H", model, vtable + slot)[0] if slot < size else 0
    if not offset:
        raise ValueError(f"field {number} is missing in the model file")
    return table + int(offset)


def _start(model: bytearray, field: int) -> tuple[int, int]:
    """First element and length of the vector that a field points to."""
    vector = _table(model, field)
    return vector + 4, _u32(model, vector)


def _vector(model: bytearray, table: int, number: int) -> range:
    """Where the offsets in a vector of tables are stored."""
    start, count = _start(model, _field(model, table, number))
    return range(start, start + 4 * count, 4)


def _scalars(model: bytearray, table: int, number: int) -> tuple[int, ...]:
    """A vector of int32."""
    start, count = _start(model, _field(model, table, number))
    return struct.unpack_from(f"<{count}i", model, start)
