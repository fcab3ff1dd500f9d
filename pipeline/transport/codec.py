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
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

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
T = TypeVar("T")

_to_json = json.JSONEncoder(separators=(",", ":")).encode
_first_value = json.JSONDecoder().raw_decode


class Encoded(NamedTuple):
    """A payload that is ready to be written: the arrays are still the payload's own."""

    header: bytes
    buffers: Sequence[tuple[int, NDArray[Any] | bytes]]  #: offsets and contents
    size: int  #: bytes of all buffers with the gaps between them

    def write_into(self, target: Bytes) -> None:
        """Copy the buffers to where they belong in `target`, which is aligned and long enough."""
        for offset, content in self.buffers:
            array = np.frombuffer(content, np.uint8) if isinstance(content, bytes) else content
            end = offset + array.nbytes
            np.copyto(target[offset:end].view(array.dtype).reshape(array.shape), array)

    def tobytes(self) -> bytes:
        """The header and, after it, the buffers."""
        parts: list[bytes | memoryview] = [self.header]
        end = 0
        for offset, content in self.buffers:
            flat = content if isinstance(content, bytes) else _flat(content)
            parts += [bytes(offset - end), flat]
            end = offset + len(flat)
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
    return Encoded(header, writer.buffers, writer.size)


def decode(header: bytes, data: Bytes, schema: PayloadSchema) -> Any:
    """The payload again; its arrays are read-only views of `data`. Raises WireError."""
    return Decoder(schema).decode(header, data)


class Decoder:
    """Decodes the payloads of one stream, whose headers are often alike: the last is kept."""

    def __init__(self, schema: PayloadSchema) -> None:
        self._schema = schema
        self._header = b"null"
        self._structure: Any = None

    def decode(self, header: bytes, data: Bytes) -> Any:
        """As `decode` above."""
        _check_size("header", len(header), HEADER_BYTES, "nothing of ours is longer")
        try:
            if header != self._header:
                self._structure = _from_json(header)
                self._header = header
            return _Reader(self._schema, data).value(self._structure, 0)
        except WireError:
            raise
        except Exception as error:  # a class of the graph may refuse its fields with anything
            raise WireError(
                "malformed",
                f"a payload is not what its header says: {type(error).__name__}: {error}",
            ) from None


def _flat(array: NDArray[Any]) -> memoryview:
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8).data


def _from_json(header: bytes) -> Any:
    """As `json.loads`, without its guess at the encoding: half of the time of a small header."""
    text = header.decode()
    value, end = _first_value(text)
    if text[end:].strip():
        raise ValueError(f"{len(text) - end} characters after its end")
    return value


def _check_size(what: str, size: int, limit: int, way_out: str) -> None:
    if size > limit:
        raise WireError("oversized", f"a {what} of {size} bytes; at most {limit} go ({way_out})")


class _Writer:
    """Collects the buffers of one payload."""

    def __init__(self, schema: PayloadSchema) -> None:
        self._schema = schema
        self.buffers: list[tuple[int, NDArray[Any] | bytes]] = []
        self.size = 0

    def node(self, value: Any, depth: int) -> Any:
        kind = type(value)
        if value is None or kind in (bool, int, float, str):
            return value
        if depth > MAX_DEPTH:
            raise WireError("malformed", f"a payload nests deeper than {MAX_DEPTH}; flatten it")
        depth += 1
        if isinstance(value, np.ndarray):
            return ["a", self._dtype(value), value.shape, self._put(value, value.nbytes)]
        if kind is bytes:
            return ["b", self._put(value, len(value)), len(value)]
        if isinstance(value, np.generic):
            array = np.asarray(value)
            return ["n", self._dtype(array), self._put(array, array.nbytes)]
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

    def _put(self, content: NDArray[Any] | bytes, size: int) -> int:
        offset = -(-self.size // ALIGN) * ALIGN
        if size:
            self.buffers.append((offset, content))
            self.size = offset + size
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
        kind = type(node)
        if kind is not list:
            if kind is dict:
                raise ValueError("a JSON object")
            return node
        if depth > MAX_DEPTH:
            raise ValueError(f"nesting deeper than {MAX_DEPTH}")
        tag, *parts = node
        read = _READ.get(tag)
        if read is None:
            raise ValueError(f"an unknown value {str(tag)[:40]}")
        return read(self, depth + 1, *parts)

    def array_of(self, depth: int, dtype: str, shape: list[int], offset: int) -> NDArray[Any]:
        kind = np.dtype(_typed(dtype, str))
        nbytes = kind.itemsize
        for side in _typed(shape, list):
            nbytes *= _typed(side, int)
            if side < 0:
                raise ValueError(f"an array of shape {str(shape)[:40]}")
        if kind.hasobject or not kind.itemsize:
            raise ValueError(f"an array of {dtype[:40]}")
        if not nbytes:
            array = np.empty(shape, kind)
            array.flags.writeable = False
            return array
        return self._take(offset, nbytes).view(kind).reshape(shape)

    def scalar_of(self, depth: int, dtype: str, offset: int) -> Any:
        return self.array_of(depth, dtype, [], offset)[()]

    def bytes_of(self, depth: int, offset: int, length: int) -> bytes:
        return self._take(offset, length).tobytes()

    def list_of(self, depth: int, values: list[Any]) -> list[Any]:
        return [self.value(item, depth) for item in _typed(values, list)]

    def tuple_of(self, depth: int, values: list[Any]) -> tuple[Any, ...]:
        return tuple(self.list_of(depth, values))

    def dict_of(self, depth: int, items: list[Any]) -> dict[Any, Any]:
        pairs = (_typed(item, list) for item in _typed(items, list))
        return {self.value(key, depth): self.value(value, depth) for key, value in pairs}

    def enum_of(self, depth: int, name: str, member: str) -> Any:
        kind = self._class(name)
        if not issubclass(kind, enum.Enum):
            raise ValueError(f"{name} is no enum")
        return kind[member]

    def instance_of(self, depth: int, name: str, values: list[Any]) -> Any:
        kind = self._class(name)
        names = self._schema.fields.get(name)
        if names is None:
            raise ValueError(f"{name} is no dataclass")
        return kind(**dict(zip(names, self.list_of(depth, values), strict=True)))

    def _class(self, name: str) -> type:
        kind = self._schema.classes.get(_typed(name, str))
        if kind is None:
            raise WireError(
                "schema",
                f"a {name[:80]} arrived where the graph declares {self._schema}; run both sides "
                "with the same graph file and code",
            )
        return kind

    def _take(self, offset: int, length: int) -> Bytes:
        if _typed(length, int) == 0:
            return self._data[:0]
        if not self._used <= _typed(offset, int) <= offset + length <= len(self._data):
            raise ValueError(f"{length} bytes at {offset} of {len(self._data)}")
        self._used = offset + length
        return self._data[offset : self._used]


_READ: Mapping[str, Callable[..., Any]] = {
    "a": _Reader.array_of,
    "n": _Reader.scalar_of,
    "b": _Reader.bytes_of,
    "t": _Reader.tuple_of,
    "l": _Reader.list_of,
    "d": _Reader.dict_of,
    "e": _Reader.enum_of,
    "c": _Reader.instance_of,
}


def _typed(value: T, kind: type) -> T:
    """A part of a header that must be of a type; JSON may hold any."""
    if type(value) is not kind:
        raise ValueError(f"{str(value)[:40]} where a {kind.__name__} belongs")
    return value
