"""The contract of a transport, held by the one in process and by Zenoh."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import pytest
from transport_ends import CHANNEL, RUN, Listener, box, envelope, until
from wire_payloads import Box, Undeclared

from pipeline.errors import TransportError, WireError
from pipeline.message import Message, Sample
from pipeline.transport.channel import Channel, Transport
from pipeline.transport.envelope import Envelope, Kind
from pipeline.transport.loopback import LoopbackNetwork
from pipeline.transport.outlet import INLINE_BYTES
from pipeline.transport.schema import PayloadSchema
from pipeline.transport.shared_files import FOLDER, PREFIX
from pipeline.transport.zenoh import Link, LinkOptions, free_endpoint

CORNERS = {"inline": 4, "slot": INLINE_BYTES}


class Ends(Protocol):
    """Makes the two ends of a network; each call starts a process anew."""

    def publisher(self) -> Transport: ...
    def subscriber(self) -> Transport: ...


class LoopbackEnds:
    def __init__(self) -> None:
        self._network = LoopbackNetwork()

    def publisher(self) -> Transport:
        return self._network.join(RUN)

    subscriber = publisher


class ZenohEnds:
    def __init__(self) -> None:
        self._endpoint = free_endpoint()

    def publisher(self) -> Transport:
        return Link(LinkOptions(listen=[self._endpoint], run=RUN))

    def subscriber(self) -> Transport:
        return Link(LinkOptions(connect=[self._endpoint], run=RUN))


@pytest.fixture(params=[LoopbackEnds, ZenohEnds])
def ends(request: pytest.FixtureRequest) -> Iterator[Ends]:
    made: list[Transport] = []
    factory = request.param()

    class Closing:
        def publisher(self) -> Transport:
            made.append(factory.publisher())
            return made[-1]

        def subscriber(self) -> Transport:
            made.append(factory.subscriber())
            return made[-1]

    yield Closing()
    for end in reversed(made):
        end.close()
    assert not list(FOLDER.glob(f"{PREFIX}{RUN}-*"))


def connected(ends: Ends, channel: Channel = CHANNEL) -> tuple[Transport, Transport, Listener]:
    """Two ends that know each other."""
    publisher, subscriber, listener = ends.publisher(), ends.subscriber(), Listener()
    publisher.advertise(channel)
    subscriber.subscribe(channel, listener)
    until(lambda: listener.arrivals)
    return publisher, subscriber, listener


@pytest.mark.parametrize("corners", CORNERS.values(), ids=CORNERS)
def test_a_message_arrives_with_everything_that_belongs_to_it(ends: Ends, corners: int) -> None:
    publisher, subscriber, listener = connected(ends)
    sent = Message(
        box(corners), 10, 9, 12, 13, 4, (Sample("camera/out", 10, 11),), "igpu", degraded=True
    )
    publisher.publish(CHANNEL.key, Envelope.of(sent, "camera/out", 11), sent.payload)
    until(lambda: listener.messages)
    arrived = listener.messages[0].envelope.message(listener.messages[0].payload)
    for name in ("stamp", "begin", "end", "received", "seq", "lineage", "executor", "degraded"):
        assert getattr(arrived, name) == getattr(sent, name)
    assert listener.messages[0].envelope.bound == 11
    np.testing.assert_array_equal(arrived.payload.corners, sent.payload.corners)
    assert not arrived.payload.corners.flags.writeable
    books = subscriber.statistics().subscribed[CHANNEL.key]
    assert (books.received, books.lost, dict(books.refused)) == (1, 0, {})
    assert books.bytes == publisher.statistics().published[CHANNEL.key].bytes
    assert publisher.statistics().published[CHANNEL.key].published == 1


def test_messages_arrive_in_the_order_of_publishing_and_small_ones_do_not_overtake(
    ends: Ends,
) -> None:
    publisher, _, listener = connected(ends, replace(CHANNEL, block=True, slots=16))
    for number in range(12):
        publisher.publish(CHANNEL.key, envelope(number), box(4 if number % 2 else INLINE_BYTES))
    until(lambda: len(listener.messages) == 12)
    assert [each.envelope.stamp for each in listener.messages] == list(range(12))


@pytest.mark.parametrize("kind", [Kind.BOUND, Kind.RELEASED, Kind.END, Kind.HELLO])
def test_news_arrive_without_a_payload(ends: Ends, kind: Kind) -> None:
    publisher, _, listener = connected(ends)
    publisher.publish(CHANNEL.key, Envelope(kind, "camera/out", 99, 98))
    until(lambda: listener.arrivals[-1].envelope.bound == 99)
    last = listener.arrivals[-1]
    assert (last.envelope.kind, last.envelope.stamp, last.payload) == (kind, 98, None)


def test_who_comes_late_is_told_the_last_bound_and_has_lost_nothing(ends: Ends) -> None:
    publisher, subscriber, listener = ends.publisher(), ends.subscriber(), Listener()
    publisher.advertise(CHANNEL)
    for number in range(3):
        publisher.publish(CHANNEL.key, envelope(number), box(4))
    subscriber.subscribe(CHANNEL, listener)
    until(lambda: listener.arrivals and listener.arrivals[-1].envelope.bound == 3)
    assert subscriber.statistics().subscribed[CHANNEL.key].missed_before == 3
    assert listener.lost == 0


def test_who_comes_after_the_end_is_told_of_it(ends: Ends) -> None:
    publisher, subscriber, listener = ends.publisher(), ends.subscriber(), Listener()
    publisher.advertise(CHANNEL)
    publisher.publish(CHANNEL.key, Envelope(Kind.END, "camera/out", 1 << 62))
    subscriber.subscribe(CHANNEL, listener)
    until(lambda: listener.arrivals and listener.arrivals[-1].envelope.kind is Kind.END)


def test_a_publisher_that_is_started_anew_is_heard_again(ends: Ends) -> None:
    publisher, subscriber, listener = connected(ends)
    publisher.publish(CHANNEL.key, envelope(7), box(INLINE_BYTES))
    until(lambda: listener.messages)
    publisher.close()
    again = ends.publisher()
    again.advertise(CHANNEL)
    until(lambda: listener.arrivals[-1].envelope.epoch != listener.messages[0].envelope.epoch)
    again.publish(CHANNEL.key, envelope(8), box(INLINE_BYTES))
    until(lambda: len(listener.messages) == 2)
    assert subscriber.statistics().subscribed[CHANNEL.key].refused == {}


def test_a_reader_that_holds_its_messages_loses_none(ends: Ends) -> None:
    publisher, subscriber, listener = connected(ends)
    for number in range(40):
        publisher.publish(CHANNEL.key, envelope(number), box(INLINE_BYTES, str(number)))
        until(lambda number=number: len(listener.messages) == number + 1)  # type: ignore[misc]
    assert [each.payload.label for each in listener.messages] == [str(n) for n in range(40)]
    assert all(each.payload.corners[-1] == INLINE_BYTES - 1 for each in listener.messages)
    assert subscriber.statistics().subscribed[CHANNEL.key].lost == 0


def test_a_reader_with_other_payload_classes_refuses_and_says_why(ends: Ends) -> None:
    publisher, subscriber, listener = ends.publisher(), ends.subscriber(), Listener()
    publisher.advertise(CHANNEL)
    other = replace(CHANNEL, schema=PayloadSchema.of([Undeclared]))
    subscriber.subscribe(other, listener)
    until(lambda: subscriber.statistics().subscribed[CHANNEL.key].refused.get("schema"))
    sentence = subscriber.statistics().subscribed[CHANNEL.key].last_refusal
    assert sentence is not None
    assert "run both sides with the same graph file and code" in sentence
    assert not listener.arrivals


def test_what_cannot_travel_is_refused_to_its_publisher_and_takes_no_number(ends: Ends) -> None:
    publisher, subscriber, listener = connected(ends)
    with pytest.raises(WireError, match="camera/out: a wire_payloads:Undeclared cannot travel"):
        publisher.publish(CHANNEL.key, envelope(0), Undeclared(1))
    publisher.publish(CHANNEL.key, envelope(1), box(INLINE_BYTES))
    with pytest.raises(WireError, match="Undeclared cannot travel"):  # its slot was announced
        publisher.publish(CHANNEL.key, envelope(2), Undeclared(1))
    publisher.publish(CHANNEL.key, envelope(3), box(4 * INLINE_BYTES))  # needs a larger one
    publisher.publish(CHANNEL.key, envelope(4), box(4))
    until(lambda: len(listener.messages) == 3)
    assert [each.envelope.number for each in listener.messages] == [0, 1, 2]
    books = subscriber.statistics().subscribed[CHANNEL.key]
    assert (books.lost, dict(books.refused)) == (0, {})


def test_between_hosts_payloads_go_whole_and_compressed_where_the_file_says_so(ends: Ends) -> None:
    channel = replace(CHANNEL, local=False, zstd=3)
    publisher, _, listener = connected(ends, channel)
    publisher.publish(CHANNEL.key, envelope(1), box(INLINE_BYTES))
    until(lambda: listener.messages)
    arrived = listener.messages[0]
    assert arrived.envelope.place.slot is None
    assert arrived.envelope.place.stored < arrived.envelope.place.size
    np.testing.assert_array_equal(arrived.payload.corners, box(INLINE_BYTES).corners)


class Halves:
    """Sends the even corners only."""

    def shrink(self, payload: Any) -> Any:
        return (payload.corners[::2], payload.label)

    def restore(self, value: Any) -> Any:
        corners, label = value
        return Box(np.repeat(corners, 2), label)


def test_a_channel_may_name_its_own_compressor(ends: Ends) -> None:
    publisher, _, listener = connected(ends, replace(CHANNEL, compressor=Halves()))
    publisher.publish(CHANNEL.key, envelope(1), box(4))
    until(lambda: listener.messages)
    assert listener.messages[0].payload.corners.tolist() == [0, 0, 2, 2]


def test_a_key_is_advertised_and_subscribed_once(ends: Ends) -> None:
    publisher, subscriber, listener = connected(ends)
    with pytest.raises(TransportError, match="advertised already"):
        publisher.advertise(CHANNEL)
    with pytest.raises(TransportError, match="subscribed already"):
        subscriber.subscribe(CHANNEL, listener)
