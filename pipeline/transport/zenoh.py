"""Zenoh between processes and hosts: one session per process, closed to the world unless opened.

The one file that imports `zenoh`. A session listens on the loopback interface, finds others only
at the endpoints it is given, and uses none of Zenoh's own shared memory, which stays behind when a
publisher is killed.
"""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import zenoh

from pipeline.closing import Closing
from pipeline.errors import TransportError
from pipeline.transport.channel import Arrival, Channel, Send, TransportStatistics
from pipeline.transport.courier import Courier
from pipeline.transport.envelope import Envelope
from pipeline.transport.inlet import Inlet
from pipeline.transport.outlet import REPEAT_S, Outlet

#: Zenoh's keys as this project sets them, before those of the file.
DEFAULTS: Mapping[str, Any] = {
    "mode": "peer",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/shared_memory/enabled": False,
    # Who starts first does not matter, and who is started anew is found again at once.
    "connect/timeout_ms": -1,
    "connect/exit_on_failure": False,
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 100, "period_increase_factor": 1},
    # One that takes the connection and does not answer (stopped, hung) would cost 10 s a try.
    "transport/unicast/open_timeout": 2000,
    "open/return_conditions/connect_scouted": False,
    "open/return_conditions/declares": False,
}
#: Zenoh takes these keys as a whole.
_WHOLE = ("access_control", "connect/retry", "downsampling", "low_pass_filter", "qos")


@dataclass(frozen=True, slots=True)
class LinkOptions:
    """How one process is reached and whom it reaches."""

    listen: Sequence[str] = ()  #: endpoints, e.g. ``tcp/127.0.0.1:7447``; none: nobody connects
    connect: Sequence[str] = ()  #: endpoints of others, tried every 100 ms for ever
    #: Zenoh's own keys, nested or with slashes, as they stand in its documentation: TLS,
    #: user and password, access control.
    zenoh: Mapping[str, Any] = field(default_factory=dict)
    run: str = "run"  #: the name of the run, in the names of shared memory


def free_endpoint(host: str = "127.0.0.1") -> str:
    """A TCP endpoint on which nobody listens now."""
    with Reserved(host) as reserved:
        return reserved.endpoint


class Reserved(Closing):
    """A TCP endpoint that the system gives to nobody else while this is open, also not between the
    end of a process that listened on it and the start of the next; a link may listen on it."""

    def __init__(self, host: str = "127.0.0.1") -> None:
        self._socket = socket.socket()
        # Bound and not listening, it is in the way of those who ask for any port, and of no link.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.bind((host, 0))
        self.endpoint = f"tcp/{host}:{self._socket.getsockname()[1]}"

    def close(self) -> None:
        self._socket.close()


def open_session(options: LinkOptions) -> zenoh.Session:
    """A bare session with this project's settings. Raises TransportError."""
    try:
        return zenoh.open(_config(options))
    except zenoh.ZError as error:
        raise TransportError(
            f"no connection opens, listening on {_listed(options.listen)} and connecting to "
            f"{_listed(options.connect)}: {error}; check the endpoints and credentials"
        ) from None


def bare_publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """A publisher of a bare session that waits for its link: by default Zenoh gives a message of
    some MB up where the link's thread does not get a core at once."""
    return session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)


class Link(Closing):
    """One process's session; a `Transport`. Use it in a ``with`` block.

    Each subscription has a thread of its own, which waits for what arrives; a slow one loses the
    oldest of its own messages (counted) and delays no other, unless its channel says `block`.
    Raises TransportError where the session cannot be opened.
    """

    def __init__(self, options: LinkOptions, *, epoch: int | None = None) -> None:
        self._run = options.run
        self._epoch = time.time_ns() if epoch is None else epoch
        self._outlets: dict[str, Outlet] = {}
        self._inlets: dict[str, Inlet] = {}
        self._publishers: list[zenoh.Publisher] = []
        self._subscribers: list[zenoh.Subscriber[Any]] = []
        self._couriers: list[Courier] = []
        self._threads: list[threading.Thread] = []
        self._over = threading.Event()
        self._session = open_session(options)
        self._start("transport", self._repeat_news)

    def advertise(self, channel: Channel) -> None:
        if channel.key in self._outlets:
            raise TransportError(f"{channel.key} is advertised already")
        publisher = self._declared(
            channel,
            partial(
                self._session.declare_publisher,
                congestion_control=_congestion(channel),
                reliability=zenoh.Reliability.RELIABLE,
            ),
        )
        send: Send = partial(_put, publisher)
        if _by_courier(channel):
            self._couriers.append(Courier(f"to-{channel.port}", send))
            send = self._couriers[-1].send
        outlet = Outlet(channel, send, run=self._run, epoch=self._epoch)
        self._publishers.append(publisher)
        self._outlets[channel.key] = outlet

        def matched(status: zenoh.MatchingStatus) -> None:
            if status.matching:
                outlet.repeat()

        publisher.declare_matching_listener(matched)

    def publish(self, key: str, envelope: Envelope, payload: Any = None) -> None:
        self._outlets[key].publish(envelope, payload)

    def subscribe(self, channel: Channel, on_arrival: Callable[[Arrival], None]) -> None:
        if channel.key in self._inlets:
            raise TransportError(f"{channel.key} is subscribed already")
        # A full ring drops its oldest; a full queue makes Zenoh, and with it the publisher, wait.
        handler = zenoh.handlers.FifoChannel if channel.block else zenoh.handlers.RingChannel
        subscriber = self._declared(
            channel, partial(self._session.declare_subscriber, handler=handler(channel.depth))
        )
        inlet = Inlet(channel, on_arrival)
        self._subscribers.append(subscriber)
        self._inlets[channel.key] = inlet
        # The handler, not the subscriber, which could not be undeclared while a thread waits in it.
        self._start(channel.port, partial(self._receive, subscriber.handler, inlet))

    def statistics(self) -> TransportStatistics:
        return TransportStatistics(
            {key: outlet.statistics() for key, outlet in self._outlets.items()},
            {key: inlet.statistics() for key, inlet in self._inlets.items()},
        )

    def peers(self) -> int:
        """How many processes are connected now; none may mean wrong credentials, which Zenoh does
        not tell to the one that has them."""
        return len(self._session.info.peers_zid())

    def close(self) -> None:
        """End the session and its threads, and remove the shared memory."""
        if self._over.is_set():
            return
        self._over.set()
        for subscriber in self._subscribers:
            with contextlib.suppress(zenoh.ZError):
                subscriber.undeclare()  # type: ignore[no-untyped-call]
        for thread in self._threads:
            thread.join()
        for courier in self._couriers:
            courier.close()
        for outlet in self._outlets.values():
            outlet.close()
        for inlet in self._inlets.values():
            inlet.close()
        with contextlib.suppress(zenoh.ZError):  # it waits for its peers, but not for ever
            self._session.close()  # type: ignore[no-untyped-call]

    def _declared(self, channel: Channel, declare: Callable[[str], Any]) -> Any:
        try:
            if set(channel.key) & set("*$"):
                raise zenoh.ZError("it has wildcards")
            return declare(channel.key)
        except zenoh.ZError as error:
            raise TransportError(f"'{channel.key}' is no key of a channel: {error}") from None

    def _receive(self, arriving: zenoh.handlers.Handler[zenoh.Sample], inlet: Inlet) -> None:
        while not self._over.is_set():
            try:
                sample = arriving.recv()
            except zenoh.ZError:
                return  # undeclared
            attachment, payload = sample.attachment, sample.payload
            head = b"" if attachment is None else attachment.to_bytes()
            inlet.take(head, len(payload), payload.to_bytes)

    def _repeat_news(self) -> None:
        while not self._over.wait(REPEAT_S / 2):
            with contextlib.suppress(TransportError):  # closed in the meantime
                for outlet in list(self._outlets.values()):
                    outlet.repeat(time.monotonic())

    def _start(self, name: str, work: Callable[[], None]) -> None:
        thread = threading.Thread(target=work, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()


def _put(publisher: zenoh.Publisher, head: bytes, body: bytes) -> None:
    try:
        publisher.put(body, attachment=head)
    except zenoh.ZError as error:
        raise TransportError(f"nothing can be published any more: {error}") from None


def _by_courier(channel: Channel) -> bool:
    """Whether a channel may wait for its link on a thread of its own.

    Zenoh would give up a large message after 50 ms, and hold up the publisher that long.
    """
    return not channel.local and not channel.block


def _congestion(channel: Channel) -> zenoh.CongestionControl:
    waits = channel.block or _by_courier(channel)
    return zenoh.CongestionControl.BLOCK if waits else zenoh.CongestionControl.DROP


def _config(options: LinkOptions) -> zenoh.Config:
    config = zenoh.Config()
    own = {"listen/endpoints": list(options.listen), "connect/endpoints": list(options.connect)}
    for key, value in (*DEFAULTS.items(), *_flat(options.zenoh), *own.items()):
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise TransportError(
                f"zenoh.{key.replace('/', '.')} cannot be {json.dumps(value)[:80]}: {error}; keys "
                "are those of Zenoh's configuration"
            ) from None
    return config


def _flat(settings: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in settings.items():
        key = f"{above}{name}"
        if isinstance(value, Mapping) and key not in _WHOLE:
            yield from _flat(value, f"{key}/")
        else:
            yield key, value


def _listed(endpoints: Sequence[str]) -> str:
    return ", ".join(endpoints) or "nothing"
