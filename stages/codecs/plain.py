"""Any payload of dataclasses and arrays, bit by bit: for what no viewer has a picture of.

    stamp, begin, end (int64 ns) | hash of the classes (uint64) | length of the header (uint64)
    header (JSON: the structure) | buffers (the arrays, aligned)

A file names its classes; only those that the reader was given are made of it.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from pipeline.errors import DataError, TransportError, WireError
from pipeline.message import Message
from pipeline.recording.codec import Schema
from pipeline.transport.codec import decode, encode
from pipeline.transport.schema import PayloadSchema

_HEAD = struct.Struct("<qqqQQ24x")  # 64 bytes: what follows stays aligned
#: A semantic map of ten million voxels; nothing that flies is larger.
MAX_BYTES = 1 << 30


class PlainCodec:
    """The codec of one payload class and of those that its fields hold. Raises DataError where its
    annotations cannot be read."""

    def __init__(self, payload: type) -> None:
        try:
            self._classes = PayloadSchema.of([payload])
        except TransportError as error:
            raise DataError(str(error)) from None
        self.schema = Schema(
            "overflight.Payload",
            "jsonschema",
            json.dumps({"title": str(self._classes)}).encode(),
            "overflight",
        )

    def encode(self, message: Message[Any]) -> bytes:
        try:
            packed = encode(message.payload, self._classes, MAX_BYTES)
        except WireError as error:
            raise DataError(str(error)) from None
        header = packed.header
        times = (message.stamp, message.begin, message.end)
        return _HEAD.pack(*times, self._classes.hash, len(header)) + packed.tobytes()

    def decode(self, data: bytes, received: int) -> Message[Any]:
        if len(data) < _HEAD.size:
            raise DataError(f"damaged payload: {len(data)} bytes")
        stamp, begin, end, classes, length = _HEAD.unpack_from(data)
        if classes != self._classes.hash:
            raise DataError(
                f"was recorded with another version of its classes than this {self._classes}"
            )
        start = _HEAD.size + length
        if start > len(data):
            raise DataError(f"damaged payload: a header of {length} bytes")
        try:
            rest = np.frombuffer(data, np.uint8, offset=start)
            payload = decode(data[_HEAD.size : start], rest, self._classes)
        except WireError as error:
            raise DataError(f"damaged payload ({error})") from None
        return Message.at(stamp, payload, begin=begin, end=end, received=received)
