"""Payloads as bytes: their structure in a small JSON header, their arrays as aligned buffers.

What travels: None, bool, int, float, str, bytes, numpy arrays and scalars (no objects), tuples,
lists, dicts, and the dataclasses and enums of the stream's `PayloadSchema`, nested. Nothing is
pickled or evaluated, and reading allocates no more than the bytes that arrived. In the header
every value that JSON has stands for itself, and any other is a list that starts with its tag:

    ["a", dtype, shape, offset]   array            ["t", values]          tuple
    ["n", dtype, offset]          numpy scalar     ["l", values]          list
    ["b", offset, length]         bytes            ["d", [[key, value]]]  dict
    ["e", class, member]          enum             ["c", class, values]   dataclass, its init fields
"""

from __future__ import annotations

import enum
import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import WireError
from pipeline.transport.schema import PayloadSchema, class_name

#: Structure, not data: long lists of numbers belong into arrays.
HEADER_BYTES = 1 << 20
#: Buffers start at multiples of this: a cache line, which every runtime accepts.
ALIGN = 64
MAX_DEPTH = 32

Bytes = NDArray[np.uint8]

_to_json = json.JSONEncoder(separators=(",", ":")).encode


@dataclass(frozen=True, slots=True)
class Encoded:
    """A payload that is ready to be written: the arrays are still the payload's own."""

    header: bytes
    buffers: tuple[tuple[int, NDArray[Any]], ...]  #: offsets and arrays
    size: int  #: bytes of all buffers with the gaps between them

    def write_into(self, target: Bytes) -> None:
        """Copy the buffers to where they belong in `target`, which is aligned and long enough."""
        for offset, array in self.buffers:
            end = offset + array.nbytes
            np.copyto(target[offset:end].view(array.dtype).reshape(array.shape), array)

    def tobytes(self) -> bytes:
        """The header and, after it, the buffers."""
        parts: list[bytes | memoryview] = [self.header]
        end = 0
        for offset, array in self.buffers:
            flat = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
            parts += [bytes(offset - end), flat.data]
            end = offset + array.nbytes
        return b"".join(parts)


def encode(value: Any, schema: PayloadSchema, max_bytes: int) -> Encoded:
    """Make a payload ready to travel. Raises WireError, which names what cannot."""
    writer = _Writer(schema)
    try:
        header = _to_json(writer.node(value, 0)).encode()
    except ValueError as error:
        raise WireError("malformed", f"the payload cannot travel: {error}") from None
    if writer.buffers:  # so that those which travel right behind it are aligned, too
        header += b" " * (-len(header) % ALIGN)
    _check_size("header", len(header), HEADER_BYTES, "put long lists into arrays")
    _check_size("payload", writer.size, max_bytes, "raise max_bytes of the edge")
    return Encoded(header, tuple(writer.buffers), writer.size)


def decode(header: bytes, data: Bytes, schema: PayloadSchema) -> Any:
    """The payload again; its arrays are read-only views of `data`. Raises WireError."""
    _check_size("header", len(header), HEADER_BYTES, "nothing of ours is longer")
    try:
        return _Reader(schema, data).value(json.loads(header), 0)
    except WireError:
        raise
    except Exception as error:  # a class of the graph may refuse its fields with anything
        raise WireError(
            "malformed", f"a payload is not what its header says: {type(error).__name__}: {error}"
        ) from None


def _check_size(what: str, size: int, limit: int, way_out: str) -> None:
    if size > limit:
        raise WireError("oversized", f"a {what} of {size} bytes; at most {limit} go ({way_out})")


class _Writer:
    """Collects the buffers of one payload."""

    def __init__(self, schema: PayloadSchema) -> None:
        self._schema = schema
        self.buffers: list[tuple[int, NDArray[Any]]] = []
        self.size = 0

    def node(self, value: Any, depth: int) -> Any:
        kind = type(value)
        if value is None or kind in (bool, int, float, str):
            return value
        if depth > MAX_DEPTH:
            raise WireError("malformed", f"a payload nests deeper than {MAX_DEPTH}; flatten it")
        depth += 1
        if isinstance(value, np.ndarray):
            return ["a", self._dtype(value), list(value.shape), self._put(value)]
        if isinstance(value, np.generic):
            array = np.asarray(value)
            return ["n", self._dtype(array), self._put(array)]
        if kind is bytes:
            return ["b", self._put(np.frombuffer(value, np.uint8)), len(value)]
        if kind is tuple or kind is list:
            return [kind.__name__[0], [self.node(item, depth) for item in value]]
        if isinstance(value, Mapping):
            return [
                "d",
                [[self.node(key, depth), self.node(item, depth)] for key, item in value.items()],
            ]
        name = class_name(kind)
        if self._schema.classes.get(name) is not kind:
            raise WireError(
                "schema",
                f"a {name} cannot travel here: the graph declares {self._schema}; annotate the "
                "port (or the field that holds it) with its class",
            )
        if isinstance(value, enum.Enum):
            return ["e", name, value.name]
        return [
            "c",
            name,
            [self.node(getattr(value, field), depth) for field in self._schema.fields[name]],
        ]

    def _dtype(self, array: NDArray[Any]) -> str:
        if array.dtype.hasobject or array.dtype.names is not None or not array.dtype.itemsize:
            raise WireError(
                "schema",
                f"an array of dtype {array.dtype} cannot travel; use numbers, text or fixed bytes",
            )
        return array.dtype.str

    def _put(self, array: NDArray[Any]) -> int:
        offset = -(-self.size // ALIGN) * ALIGN
        if array.nbytes:
            self.buffers.append((offset, array))
            self.size = offset + array.nbytes
        return offset


class _Reader:
    """Builds one payload over its bytes, of which each is used once."""

    def __init__(self, schema: PayloadSchema, data: Bytes) -> None:
        self._schema = schema
        self._data = data
        if data.flags.writeable:
            self._data = data.view()
            self._data.flags.writeable = False
        self._used = 0  #: offset up to which the bytes belong to values already read

    def value(self, node: Any, depth: int) -> Any:
        if not isinstance(node, list):
            if isinstance(node, dict):
                raise ValueError("a JSON object")
            return node
        if depth > MAX_DEPTH:
            raise ValueError(f"nesting deeper than {MAX_DEPTH}")
        depth += 1
        match node:
            case ["a", str(dtype), list(shape), int(offset)]:
                return self._array(dtype, shape, offset)
            case ["n", str(dtype), int(offset)]:
                return self._array(dtype, [], offset)[()]
            case ["b", int(offset), int(length)]:
                return self._take(offset, length).tobytes()
            case ["t", list(values)]:
                return tuple([self.value(item, depth) for item in values])
            case ["l", list(values)]:
                return [self.value(item, depth) for item in values]
            case ["d", list(items)]:
                return {self.value(key, depth): self.value(item, depth) for key, item in items}
            case ["e", str(name), str(member)]:
                kind = self._class(name)
                if not issubclass(kind, enum.Enum):
                    raise ValueError(f"{name} is no enum")
                return kind[member]
            case ["c", str(name), list(values)]:
                kind = self._class(name)
                if name not in self._schema.fields:
                    raise ValueError(f"{name} is no dataclass")
                given = [self.value(item, depth) for item in values]
                return kind(**dict(zip(self._schema.fields[name], given, strict=True)))
        raise ValueError(f"an unknown value {str(node[:1])[:40]}")

    def _class(self, name: str) -> type:
        kind = self._schema.classes.get(name)
        if kind is None:
            raise WireError(
                "schema",
                f"a {name[:80]} arrived where the graph declares {self._schema}; run both sides "
                "with the same graph file and code",
            )
        return kind

    def _array(self, dtype: str, shape: list[Any], offset: int) -> NDArray[Any]:
        kind = np.dtype(dtype)
        if kind.hasobject or kind.itemsize == 0 or any(type(n) is not int or n < 0 for n in shape):
            raise ValueError(f"an array of {dtype[:40]} {str(shape)[:40]}")
        nbytes = prod(shape) * kind.itemsize
        if not nbytes:
            array = np.empty(shape, kind)
            array.flags.writeable = False
            return array
        return self._take(offset, nbytes).view(kind).reshape(shape)

    def _take(self, offset: int, length: int) -> Bytes:
        if length == 0:
            return self._data[:0]
        if not self._used <= offset <= offset + length <= len(self._data):
            raise ValueError(f"{length} bytes at {offset} of {len(self._data)}")
        self._used = offset + length
        return self._data[offset : self._used]
