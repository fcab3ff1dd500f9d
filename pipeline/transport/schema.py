"""What may travel on a stream: the payload classes that the graph declares, and their hash.

A receiver builds these classes and no others, so a peer cannot name a class of its choice. Both
ends compute the hash from their own code: another version of a class is refused in words, not
misread.
"""

from __future__ import annotations

import enum
import hashlib
import re
import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from types import MappingProxyType
from typing import Any

from pipeline.errors import TransportError


@dataclass(frozen=True, slots=True)
class PayloadSchema:
    """The classes of one stream by their names, ``module:Class``."""

    classes: Mapping[str, type]
    fields: Mapping[str, tuple[str, ...]]  #: what the dataclasses among them are made of
    hash: int  #: 64 bits over names, fields and annotations; equal where both ends agree

    @classmethod
    def of(cls, types: Iterable[Any]) -> PayloadSchema:
        """The schema of a port's payload types: their dataclasses and enums, and all that the
        annotations of those reach.

        Types without fields of their own (arrays, numbers, `Any`) add nothing: plain values always
        travel. Raises TransportError where an annotation cannot be read.
        """
        found: dict[str, type] = {}
        waiting = [kind for annotation in types for kind in _classes(annotation)]
        while waiting:
            kind = waiting.pop()
            if found.setdefault(class_name(kind), kind) is not kind:
                raise TransportError(
                    f"two classes are called {class_name(kind)}; rename one, or declare it once"
                )
            waiting.extend(
                inner
                for annotation in _hints(kind).values()
                for inner in _classes(annotation)
                if class_name(inner) not in found
            )
        ordered = {name: found[name] for name in sorted(found)}
        parts = {
            name: tuple(field.name for field in fields(kind) if field.init)
            for name, kind in ordered.items()
            if is_dataclass(kind)
        }
        return cls(MappingProxyType(ordered), MappingProxyType(parts), _hash(ordered))

    def __str__(self) -> str:
        return f"{', '.join(self.classes) or 'plain values'} ({self.hash:016x})"


def class_name(kind: type) -> str:
    """``module:Class``, as a graph file would write it."""
    return f"{kind.__module__}:{kind.__qualname__}"


def _classes(annotation: Any) -> Iterator[type]:
    """The dataclasses and enums in an annotation, also inside unions, tuples and mappings."""
    if isinstance(annotation, type) and (
        is_dataclass(annotation) or issubclass(annotation, enum.Enum)
    ):
        yield annotation
    for argument in typing.get_args(annotation):
        if argument is not ...:
            yield from _classes(argument)


def _hints(kind: type) -> dict[str, Any]:
    if not is_dataclass(kind):
        return {}
    try:
        return typing.get_type_hints(kind)
    except Exception as error:  # whatever evaluating an annotation raises
        raise TransportError(
            f"a field of {class_name(kind)} cannot be read: {error}; import what it names at run "
            "time, not under TYPE_CHECKING"
        ) from None


def _hash(classes: Mapping[str, type]) -> int:
    text = "\n".join(f"{name}({','.join(_parts(kind))})" for name, kind in classes.items())
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")


def _parts(kind: type) -> Iterator[str]:
    if not is_dataclass(kind):
        yield from typing.cast(type[enum.Enum], kind).__members__
        return
    for field in fields(kind):
        # The annotation as written; a class given as an object (no postponed evaluation) by name.
        text = field.type if isinstance(field.type, str) else getattr(field.type, "__name__", "")
        yield f"{field.name}:{re.sub(r'[^A-Za-z0-9_]', '', text or str(field.type))}"
