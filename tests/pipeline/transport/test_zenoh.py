"""Zenoh's link under slow readers, killed publishers and late starts."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import zenoh
from transport_ends import CHANNEL, RUN, Listener, box, envelope, until

from pipeline.errors import TransportError
from pipeline.transport.channel import Arrival, ChannelStatistics
from pipeline.transport.envelope import Envelope, Kind
from pipeline.transport.outlet import INLINE_BYTES
from pipeline.transport.shared_files import FOLDER, PREFIX, sweep
from pipeline.transport.zenoh import DEFAULTS, Link, LinkOptions, Reserved, free_endpoint

HERE = Path(__file__).parent
OTHER = replace(CHANNEL, key="test/lidar/out", port="lidar/out")


@contextmanager
def pair() -> Iterator[tuple[Link, Link]]:
    endpoint = free_endpoint()
    with (
        Link(LinkOptions(listen=[endpoint], run=RUN)) as publisher,
        Link(LinkOptions(connect=[endpoint], run=RUN)) as subscriber,
    ):
        yield publisher, subscriber


class Slow(Listener):
    """Stands still at its first message until it is let go."""

    def __init__(self) -> None:
        super().__init__()
        self.go = threading.Event()

    def __call__(self, arrival: Arrival) -> None:
        super().__call__(arrival)
        if arrival.envelope.kind is Kind.MESSAGE:
            self.go.wait(200)


def books(link: Link) -> ChannelStatistics:
    return link.statistics().subscribed[CHANNEL.key]


@pytest.mark.parametrize("local", [True, False], ids=["one host", "two hosts"])
def test_a_slow_reader_gets_the_latest_loses_its_own_by_count_and_delays_no_other(
    local: bool,
) -> None:
    slow, other = Slow(), Listener()
    # News that repeat wait among the messages, five a second: with fewer places a test that stands
    # still would find the last message pushed out by them.
    channel = replace(CHANNEL, local=local, depth=20)
    with pair() as (publisher, subscriber):
        for each, listener in ((channel, slow), (OTHER, other)):
            publisher.advertise(each)
            subscriber.subscribe(each, listener)
        until(lambda: slow.arrivals and other.arrivals)
        for number in range(60):
            publisher.publish(channel.key, envelope(number), box(INLINE_BYTES, str(number)))
            news = Envelope(Kind.BOUND, "lidar/out", number)
            publisher.publish(OTHER.key, news)
            until(lambda: other.arrivals[-1].envelope.bound == news.bound)  # noqa: B023
        slow.go.set()
        until(lambda: slow.arrivals[-1].envelope.number == 60)  # the news that repeat
        assert len(slow.messages) + slow.lost == 60
        assert slow.messages[-1].payload.label == "59"
        # One in its hand and those that wait; between hosts the courier has two more under way.
        assert 1 <= len(slow.messages) <= 1 + channel.depth + (0 if local else 2)
        assert (books(subscriber).received, books(subscriber).lost) == (
            len(slow.messages),
            slow.lost,
        )


def test_a_channel_that_blocks_loses_nothing_to_a_slow_reader() -> None:
    slow = Slow()
    channel = replace(CHANNEL, block=True, depth=2, local=False)
    with pair() as (publisher, subscriber):
        publisher.advertise(channel)
        subscriber.subscribe(channel, slow)
        until(lambda: slow.arrivals)

        def publish() -> None:
            for number in range(200):
                publisher.publish(channel.key, envelope(number), box(INLINE_BYTES))

        thread = threading.Thread(target=publish)
        thread.start()
        until(lambda: slow.messages)
        slow.go.set()
        thread.join()
        until(lambda: len(slow.messages) == 200)
        assert slow.lost == 0


PATIENCE = "transport/unicast/open_timeout"


def test_we_are_less_patient_than_zenoh_with_one_that_does_not_answer() -> None:
    assert DEFAULTS[PATIENCE] < json.loads(zenoh.Config().get_json(PATIENCE))


@pytest.mark.realtime
def test_who_takes_a_connection_and_does_not_answer_is_tried_again_soon() -> None:
    endpoint = free_endpoint()
    patient = {PATIENCE: 100_000}
    with socket.socket() as hung:
        hung.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        hung.bind(("127.0.0.1", int(endpoint.rpartition(":")[2])))
        hung.listen()
        with (
            Link(LinkOptions(connect=[endpoint], run=RUN, zenoh=patient)) as waits,
            hung.accept()[0],
            Link(LinkOptions(connect=[endpoint], run=RUN)) as link,
            hung.accept()[0],
        ):
            hung.close()
            with Link(LinkOptions(listen=[endpoint], run=RUN)):
                until(lambda: link.peers() == 1)
                assert waits.peers() == 0


def test_a_closed_link_publishes_no_more_and_says_so() -> None:
    with pair() as (publisher, _):
        publisher.advertise(CHANNEL)
        publisher.close()
        with pytest.raises(TransportError, match="nothing can be published any more"):
            publisher.publish(CHANNEL.key, envelope(0), box(4))


def test_who_starts_first_does_not_matter() -> None:
    endpoint, listener = free_endpoint(), Listener()
    with Link(LinkOptions(connect=[endpoint])) as subscriber:
        subscriber.subscribe(CHANNEL, listener)
        with Link(LinkOptions(listen=[endpoint])) as publisher:
            publisher.advertise(CHANNEL)
            publisher.publish(CHANNEL.key, Envelope(Kind.END, "camera/out", 5))
            until(lambda: listener.arrivals)


def test_a_reserved_endpoint_is_ours_before_between_and_after_its_links() -> None:
    with Reserved() as reserved:
        port = int(reserved.endpoint.rpartition(":")[2])

        def assert_nobody_gets_it() -> None:
            with socket.socket() as other, pytest.raises(OSError, match="in use"):
                other.bind(("127.0.0.1", port))

        for _ in range(2):
            assert_nobody_gets_it()
            with Link(LinkOptions(listen=[reserved.endpoint])):
                assert_nobody_gets_it()
        assert_nobody_gets_it()


def test_a_link_ends_with_its_threads_and_descriptors_also_twice() -> None:
    def held() -> tuple[int, int]:
        return threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))

    def once() -> None:
        with pair() as (publisher, subscriber):
            publisher.advertise(CHANNEL)
            subscriber.subscribe(CHANNEL, Listener())
            publisher.close()

    once()  # what the library keeps for good
    before = held()
    once()
    until(lambda: held() <= before)


@contextmanager
def process(endpoint: str, run: str) -> Iterator[subprocess.Popen[bytes]]:
    path = os.pathsep.join(map(str, (HERE.parents[2], HERE)))
    with subprocess.Popen(
        [sys.executable, str(HERE / "link_process.py"), endpoint, run],
        env={**os.environ, "PYTHONPATH": path},
    ) as child:
        try:
            yield child
        finally:
            child.kill()


def of_another_life(messages: list[Arrival], lives: list[int]) -> list[Arrival]:
    return [each for each in messages if each.envelope.epoch not in lives]


@pytest.mark.slow
@pytest.mark.realtime
def test_a_killed_publisher_is_heard_again_and_leaves_nothing() -> None:
    killed = f"{RUN}-killed"
    listener = Listener()
    with (
        Reserved() as reserved,
        Link(LinkOptions(connect=[reserved.endpoint])) as subscriber,
    ):
        subscriber.subscribe(CHANNEL, listener)
        lives = []
        for _ in range(3):
            with process(reserved.endpoint, killed):
                # Those of the life before may still be coming.
                until(lambda: len(of_another_life(listener.messages, lives)) > 5)
                lives.append(listener.messages[-1].envelope.epoch)
            sweep(killed)  # another run that starts now may have done so before us
        assert len(set(lives)) == 3
        assert set(books(subscriber).refused) <= {
            "gone"
        }  # announced, and killed before it was filled
        assert int(listener.messages[-1].payload.corners[-1]) == INLINE_BYTES - 1
        # First what was heard: the books go on while the last messages come.
        last = {each.envelope.epoch: each.envelope.number + 1 for each in listener.messages}
        book = books(subscriber)
        assert book.received + book.lost + book.missed_before >= sum(last.values())
    assert not list(FOLDER.glob(f"{PREFIX}{killed}-*"))
