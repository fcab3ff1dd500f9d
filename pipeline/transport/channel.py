"""One stream between processes: what both ends must know of it, what arrives, what is counted.

`Transport` is the waist: Zenoh (`zenoh.py`) and the in-process `LoopbackTransport` (`loopback.py`)
answer it, and one contract test runs over both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple, Protocol

from pipeline.transport.envelope import Envelope
from pipeline.transport.schema import PayloadSchema

#: Takes an envelope and what goes with it; must not wait unless the channel says `block`.
Send = Callable[[bytes, bytes], None]

#: A 12-megapixel RGB image with room to spare; a channel may say otherwise.
MAX_BYTES = 64 << 20


class Refused(StrEnum):
    """Why something that arrived was not taken; each is counted."""

    VERSION = "version"  #: another version of the wire format
    MALFORMED = "malformed"  #: truncated, or not what its own sizes say
    OVERSIZED = "oversized"  #: more than the channel takes
    SCHEMA = "schema"  #: made of other classes, or other fields, than the graph declares
    CHANNEL = "channel"  #: of another channel than the one it came on
    REPLAYED = "replayed"  #: a number that was seen, or passed, before
    STALE = "stale"  #: of an earlier life of its publisher
    GONE = "gone"  #: its bytes were overwritten, or removed, before they were read


class Compressor(Protocol):
    """How an edge shrinks its payloads (a graph file names it, ``module:Class``): a payload to
    plain values and back, e.g. an image to JPEG bytes and its camera's name."""

    def shrink(self, payload: Any) -> Any: ...

    def restore(self, value: Any) -> Any:
        """Raises ValueError for what `shrink` never gives."""
        ...


@dataclass(frozen=True, slots=True)
class Channel:
    """One stream, as its publisher and each of its subscribers read it from the graph file."""

    key: str  #: Zenoh's key expression without wildcards, e.g. ``uav/fuse_cloud/out``
    port: str  #: ``stage/port``, as messages name it
    schema: PayloadSchema
    local: bool = True  #: all ends on one host: large payloads go by shared memory
    #: The publisher waits for a slow network or reader; else latest wins. From a reader that takes
    #: nothing for 5 s Zenoh parts, and what was under way is lost, and counted.
    block: bool = False
    max_bytes: int = MAX_BYTES  #: the most that one payload may take
    #: Of the ring, at first; it grows where readers hold them. A slot that no reader has come to
    #: is written anew after so many messages: where none may be lost, more than can be under way.
    slots: int = 4
    ring_bytes: int = 256 << 20  #: the most that the ring grows to
    #: Messages that a reader lets wait before the oldest is lost, or the publisher waits: 160 ms of
    #: poses at 200 Hz, which is longer than what usually holds up a thread.
    depth: int = 32
    zstd: int | None = None  #: level for payloads that go whole; None: as they are
    compressor: Compressor | None = None
    #: What lies between this end and the network, where a graph's faults say so.
    wire: Callable[[Send], Send] | None = None


class Arrival(NamedTuple):
    """What a subscriber gets: a message, or news of a stream's bound or end."""

    envelope: Envelope
    payload: Any  #: None where the envelope is no message
    lost: int = 0  #: messages before this that will never come


@dataclass(frozen=True, slots=True)
class ChannelStatistics:
    """The books of one end of a channel."""

    published: int = 0  #: messages
    received: int = 0  #: messages handed on
    lost: int = 0  #: numbers that never came, or whose bytes were gone
    missed_before: int = 0  #: published before this end first heard of the publisher
    refused: Mapping[str, int] = field(default_factory=dict)  #: by `Refused`
    last_refusal: str | None = None  #: the sentence
    bytes: int = 0  #: of payloads, sent or received
    sent_whole: int = 0  #: local messages that found no free slot and went through Zenoh whole


@dataclass(frozen=True, slots=True)
class TransportStatistics:
    """The books of one process by key."""

    published: Mapping[str, ChannelStatistics]
    subscribed: Mapping[str, ChannelStatistics]


class Transport(Protocol):
    """Carries messages between processes. `publish` may be called from any thread; `on_arrival` is
    called from one thread per subscription, in the order of publishing."""

    def advertise(self, channel: Channel) -> None:
        """Announce that this end publishes on `channel`; once, before `publish`."""
        ...

    def publish(self, key: str, envelope: Envelope, payload: Any = None) -> None:
        """Send a message, or news of the stream. Raises WireError where a payload cannot travel."""
        ...

    def subscribe(self, channel: Channel, on_arrival: Callable[[Arrival], None]) -> None:
        """Hand everything that arrives on `channel` to `on_arrival`, the last news at once."""
        ...

    def statistics(self) -> TransportStatistics:
        """The books of every channel so far."""
        ...

    def close(self) -> None: ...
