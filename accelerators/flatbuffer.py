"""Read FlatBuffers without a schema compiler: tables whose fields are found by their numbers.

Offsets in a file may point anywhere: whatever lies outside the bytes raises ValueError.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any, NamedTuple


class Table(NamedTuple):
    """One table. A field that the file leaves out has its type's default: 0, nothing, empty."""

    data: bytes | bytearray
    at: int

    @classmethod
    def root(cls, data: bytes | bytearray) -> Table:
        """The outermost table of a file."""
        return cls(data, _unpack("<I", data, 0))

    def field(self, number: int) -> int | None:
        """Where the value of a field is stored; None where it is left out."""
        vtable = self.at - _unpack("<i", self.data, self.at)
        slot = 4 + 2 * number
        if slot >= _unpack("<H", self.data, vtable):
            return None
        offset = _unpack("<H", self.data, vtable + slot)
        return self.at + offset if offset else None

    def number(self, field: int, form: str, default: Any = 0) -> Any:
        """A scalar, `form` as in `struct`: "b", "i", "I", "f" ..."""
        at = self.field(field)
        return default if at is None else _unpack(f"<{form}", self.data, at)

    def table(self, field: int) -> Table | None:
        """The table that a field points to."""
        at = self.field(field)
        return None if at is None else self._pointed(at)

    def vector(self, field: int) -> tuple[int, int]:
        """Where the first element of a vector is stored, and how many there are."""
        at = self.field(field)
        if at is None:
            return 0, 0
        start = at + _unpack("<I", self.data, at)
        return start + 4, _unpack("<I", self.data, start)

    def tables(self, field: int) -> Iterator[Table]:
        """The tables of a vector."""
        start, count = self.vector(field)
        for number in range(count):
            yield self._pointed(start + 4 * number)

    def numbers(self, field: int, form: str = "i") -> tuple[Any, ...]:
        """The scalars of a vector."""
        start, count = self.vector(field)
        try:
            return struct.unpack_from(f"<{count}{form}", self.data, start)
        except struct.error:
            raise ValueError(_BROKEN) from None

    def text(self, field: int) -> str:
        """A string."""
        start, count = self.vector(field)
        return bytes(self.data[start : start + count]).decode("utf-8", "replace")

    def _pointed(self, at: int) -> Table:
        return Table(self.data, at + _unpack("<I", self.data, at))


_BROKEN = "the file is cut short or damaged"


def _unpack(form: str, data: bytes | bytearray, at: int) -> Any:
    if at < 0:
        raise ValueError(_BROKEN)
    try:
        return struct.unpack_from(form, data, at)[0]
    except struct.error:
        raise ValueError(_BROKEN) from None
