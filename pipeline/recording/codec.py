"""What a recording asks of a payload type: a schema, and bytes there and back.

The codec of a payload lives beside the payload, not here: this floor knows no sensor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from pipeline.message import Message

#: The keys of a channel's metadata that name the payload type, and the class with its module.
PAYLOAD, PAYLOAD_CLASS = "payload", "class"


@dataclass(frozen=True, slots=True)
class Schema:
    """What a channel's bytes are, for any program that reads the file."""

    name: str  #: e.g. ``foxglove.PointCloud``
    encoding: str  #: of the schema, e.g. ``protobuf``
    data: bytes  #: the schema itself
    message_encoding: str  #: of the messages, e.g. ``protobuf``


class Codec(Protocol):
    """Between messages of one payload type and bytes; stateless, so any thread may use it."""

    @property
    def schema(self) -> Schema: ...

    def encode(self, message: Message[Any]) -> bytes:
        """Payload, stamp and extent as bytes; `received` is the recording's own time."""
        ...

    def decode(self, data: bytes, received: int) -> Message[Any]:
        """The message again; its arrays are read-only. Raises DataError for other bytes."""
        ...


class Codecs(Protocol):
    """The codecs of the floors above, as a recorder and a replay ask for them."""

    def writing(self, payload: object) -> Codec:
        """The codec that keeps every bit of a payload. Raises DataError where there is none."""
        ...

    def reading(self, schema: str, metadata: Mapping[str, str]) -> Codec | None:
        """The codec of a channel with this schema; None where its messages are no payload."""
        ...
