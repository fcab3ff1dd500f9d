"""Where a part of a graph meets the other processes: its scheduler on one side, a transport on the
other.

Messages of a sender's port go out with the least stamp that may follow; what arrives enters the
scheduler as an event, on the transport's thread. Bounds and what was taken are told as news, which
the transport repeats, so that one who comes late, or anew, hears them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, Protocol

from pipeline.clock import Clock
from pipeline.drivers.sealing import seal
from pipeline.drivers.sender import Sender
from pipeline.drivers.shared_clock import ClockBeacon
from pipeline.graph.placing import compressor
from pipeline.message import Message
from pipeline.scheduling.bounds import INFINITY
from pipeline.scheduling.events import Bound, Notice, Run
from pipeline.scheduling.partition import Link, Part
from pipeline.scheduling.topology import Policy, Port, Sync
from pipeline.transport.bad_wire import BadWire, WireFaults
from pipeline.transport.channel import Arrival, Channel, Send, Transport
from pipeline.transport.envelope import NO_BOUND, Envelope, Kind
from pipeline.transport.schema import PayloadSchema

#: zstd's fastest level: 4.2 MB of a cloud take 15 ms.
ZSTD_LEVEL = 1
#: What news of a window carry is no payload.
_NO_PAYLOAD = PayloadSchema.of([])


class Driver(Protocol):
    """What the exchange asks of the part's driver."""

    def arrived(self, port: Port, message: Message[Any]) -> None: ...
    def bounded(self, port: Port, bound: int) -> None: ...
    def sent(self, runs: Sequence[Run]) -> None: ...


class Exchange:
    """One part's links: `open` and `connect` it before the run, then `begin` with the driver.

    `run` begins its keys. `enter_thread` is called once on each thread that brings messages.
    """

    def __init__(
        self,
        run: str,
        part: Part,
        schemas: Mapping[Port, PayloadSchema],
        enter_thread: Callable[[], None],
        *,
        tells_clock: bool = False,
        faults: Mapping[Port, WireFaults] = MappingProxyType({}),
    ) -> None:
        """`tells_clock`: other hosts follow the graph's clock of this part. `faults`: of links."""
        self._faults = faults
        self._bad_wires: list[BadWire] = []
        self._tells_clock = tells_clock
        self._clock: Clock | None = None
        self._beacon: ClockBeacon | None = None
        self._run = run
        self._part = part
        self._schemas = schemas
        self._enter_thread = enter_thread
        self._transport: Transport | None = None
        self._known = threading.local()
        self._driver: Driver | None = None
        self._begun = threading.Event()
        self._heard: set[Port] = set()  #: ports whose process is there
        self.senders = {
            link.sender: Sender(link, partial(self._send, link)) for link in part.outgoing
        }
        self._taken = {  #: by port, then stage with ``policy: block``: up to which seq it took
            link.port: {
                node.name: -1
                for node in part.topology.stages
                for rule in node.inputs
                if link.port in rule.sources
                and rule.sync is Sync.TRIGGER
                and rule.policy is Policy.BLOCK
            }
            for link in part.incoming
            if part.process in link.waiting
        }
        self._compressors = {
            link.port: compressor(link.compress)
            for link in (*part.outgoing, *part.incoming)
            if link.compress not in (None, "zstd") and not link.local
        }
        self._told = dict.fromkeys(self._taken, -1)
        self._newest: dict[Port, int] = {}  #: the last seq that arrived
        self._lost: dict[Port, int] = {}  #: the last seq that is known not to come
        self._lives: dict[Port, int] = {}  #: the sender's epoch
        self._lock = threading.Lock()

    def open(self, transport: Transport) -> None:
        """Give it its transport; whoever opened that closes it."""
        self._transport = transport

    def connect(self) -> None:
        """Announce what goes out and ask for what comes in. Raises TransportError."""
        for link in self._part.outgoing:
            self._wire.advertise(self._channel(link))
            for reader in link.waiting:
                heard = partial(self._took, self.senders[link.sender], reader)
                self._wire.subscribe(self._window(link, reader), heard)
        for link in self._part.incoming:
            if self._part.process in link.waiting:
                self._wire.advertise(self._window(link, self._part.process))
                self._tell_taken(link.port)
            self._wire.subscribe(self._channel(link), partial(self._arrived, link.port))

        if self._tells_clock:
            self._beacon = ClockBeacon(self._run, self._part.process, self._wire)

    def missing(self) -> list[Port]:
        """The ports of this host whose process has not been heard of."""
        incoming = self._part.incoming
        return [link.port for link in incoming if link.local and link.port not in self._heard]

    def begin(self, driver: Driver, clock: Clock, origin: int = 0) -> None:
        """From now on what arrives goes to the driver; the clock began at `origin`."""
        self._driver = driver
        self._clock = clock
        for wire in self._bad_wires:
            wire.begin(lambda: (clock.now() - origin) / 1e9)
        self._begun.set()

    def gone(self, process: str) -> None:
        """A process will not come back: its streams end."""
        for link in self._part.incoming:
            if link.origin == process and self._driver is not None:
                self._driver.bounded(link.port, INFINITY)

    def end(self) -> None:
        """Nothing goes to the driver any more; what a slow link holds goes out."""
        for wire in self._bad_wires:
            wire.close()
        self._driver = None
        self._begun.set()

    # ------------------------------------------------------------------ out

    def tell(self, notice: Notice) -> None:
        """Tell the others how far a stream is, or what was taken here."""
        if isinstance(notice, Bound):
            link = self.senders[notice.sender].link
            kind = Kind.END if notice.bound >= INFINITY else Kind.BOUND
            news = Envelope(kind, str(link.port), notice.bound)
            self._wire.publish(self.key(link), news)
            return
        with self._lock:
            stages = self._taken[notice.port]
            if notice.seq > self._newest.get(notice.port, -1):
                return  # of the sender's earlier life
            seq = notice.seq
            if seq == self._newest.get(notice.port):  # and what was lost after it
                seq = max(seq, self._lost.get(notice.port, -1))
            stages[notice.stage] = max(stages[notice.stage], seq)
            if min(stages.values()) <= self._told[notice.port]:
                return
            self._told[notice.port] = min(stages.values())
        self._tell_taken(notice.port)

    def tick(self) -> None:
        """Let go what a reader that is gone will not take; tell the clock."""
        if self._beacon is not None and self._clock is not None:
            self._beacon.tell(self._clock)
        for sender in self.senders.values():
            self._over(sender)

    def _send(self, link: Link, message: Message[Any]) -> None:
        envelope = Envelope.of(message, str(link.port), message.stamp + 1)
        self._wire.publish(self.key(link), envelope, message.payload)

    def _tell_taken(self, port: Port) -> None:
        link = next(link for link in self._part.incoming if link.port == port)
        news = Envelope(Kind.BOUND, str(port), self._told[port])
        self._wire.publish(self._window(link, self._part.process).key, news)

    # ------------------------------------------------------------------ in

    def _arrived(self, port: Port, arrival: Arrival) -> None:
        """On the transport's thread for this port."""
        self._enter()
        self._heard.add(port)
        envelope = arrival.envelope
        self._note_life(port, envelope.epoch)
        if envelope.kind is Kind.HELLO:
            return
        self._begun.wait()  # what came before the run waits with its thread
        if (driver := self._driver) is None:
            return
        if envelope.kind is Kind.MESSAGE:
            self._newest[port] = envelope.seq
            seal(arrival.payload)
            driver.arrived(port, envelope.message(arrival.payload))
        elif port in self._taken and envelope.seq > self._newest.get(port, -1):
            self._note_lost(port, envelope.seq)
        bound = INFINITY if envelope.kind is Kind.END else envelope.bound
        if bound > max(envelope.stamp + 1, NO_BOUND):
            driver.bounded(port, bound)

    def _note_life(self, port: Port, epoch: int) -> None:
        """A sender that was started anew counts from 0, and so do we what we took of it."""
        before, self._lives[port] = self._lives.get(port), epoch
        if before in (None, epoch) or port not in self._taken:
            return
        with self._lock:
            self._taken[port] = dict.fromkeys(self._taken[port], -1)
            self._told[port] = -1
            self._newest[port] = self._lost[port] = -1
        self._tell_taken(port)

    def _note_lost(self, port: Port, seq: int) -> None:
        """News that came after a message `seq`, which has not come: it was lost, or sent before
        this end listened. Nobody here can take it, so the sender is told as if it were taken, once
        what came before it was."""
        with self._lock:
            stages, newest = self._taken[port], self._newest.get(port, -1)
            self._lost[port] = max(seq, newest)
            for stage, taken in stages.items():
                if taken >= newest:
                    stages[stage] = max(taken, seq)
            if min(stages.values()) <= self._told[port]:
                return
            self._told[port] = min(stages.values())
        self._tell_taken(port)

    def _enter(self) -> None:
        """A thread of the transport's that is new here counts as one of the driver's."""
        if not getattr(self._known, "entered", False):
            self._known.entered = True
            self._enter_thread()

    def _took(self, sender: Sender, reader: str, arrival: Arrival) -> None:
        self._enter()
        if arrival.envelope.kind is Kind.BOUND:
            sender.heard(reader, arrival.envelope.bound)
            self._over(sender)

    def _over(self, sender: Sender) -> None:
        driver = self._driver
        if driver is not None and (runs := sender.over()):
            driver.sent(runs)

    # ------------------------------------------------------------------ books and names

    def books(self) -> Mapping[str, Any]:
        """What went over each link, as counted at this end."""
        known = self._wire.statistics()
        return {
            "out": {
                name: {
                    "port": str(sender.link.port),
                    "sent": begin.published,
                    "sent_whole": begin.sent_whole,
                    "failed": sender.failed,
                }
                for name, sender in self.senders.items()
                for begin in [known.published[self.key(sender.link)]]
            },
            "in": {
                str(link.port): {
                    "received": end.received,
                    "lost": end.lost + end.missed_before,
                    "refused": dict(end.refused),
                    "last_refusal": end.last_refusal,
                    "bytes": end.bytes,
                }
                for link in self._part.incoming
                for end in [known.subscribed[self.key(link)]]
            },
        }

    @property
    def _wire(self) -> Transport:
        assert self._transport is not None, "not open"
        return self._transport

    def key(self, link: Link) -> str:
        """The link's key in the transport."""
        return f"{self._run}/{link.port}/to/{link.host}"

    def _channel(self, link: Link) -> Channel:
        return Channel(
            self.key(link),
            str(link.port),
            self._schemas[link.port],
            local=link.local,
            block=link.window is not None,
            slots=4 + (link.window or 0),
            depth=max(64, link.window or 0) if link.local else max(4, link.window or 0),
            zstd=ZSTD_LEVEL if link.compress == "zstd" else None,
            compressor=self._compressors.get(link.port),
            wire=self._wire_of(link.port) if link.origin == self._part.process else None,
        )

    def _window(self, link: Link, reader: str) -> Channel:
        return Channel(
            f"{self._run}/{link.port}/taken/{reader}",
            str(link.port),
            _NO_PAYLOAD,
            local=link.local,
            wire=self._wire_of(link.port) if reader == self._part.process else None,
        )

    def _wire_of(self, port: Port) -> Callable[[Send], Send] | None:
        """What a port's faults lay before this end; both ways are cut alike."""
        if port not in self._faults:
            return None
        self._bad_wires.append(BadWire(self._faults[port], str(port)))
        return self._bad_wires[-1].lay
