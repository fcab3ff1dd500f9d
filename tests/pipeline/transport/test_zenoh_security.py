"""Zenoh's link is closed unless it is opened, and opens only to those whom the file names."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest
import zenoh
from certificates import Authority
from transport_ends import CHANNEL, Listener, box, envelope, until
from wire_payloads import Box

from pipeline.errors import TransportError
from pipeline.transport.envelope import Envelope, Kind, pack
from pipeline.transport.schema import PayloadSchema
from pipeline.transport.zenoh import Link, LinkOptions, free_endpoint

#: Connecting takes some ms; a link that could be there after this is one that was refused.
REFUSED_S = 1.0


@contextmanager
def listened(
    listening: Mapping[str, Any], connecting: Mapping[str, Any], scheme: str = "tcp"
) -> Iterator[tuple[Listener, Link, Link]]:
    """Who listens to a message from a listening to a connecting process with these settings, and
    the two."""
    endpoint = free_endpoint()
    if scheme != "tcp":
        endpoint = endpoint.replace("tcp/127.0.0.1", f"{scheme}/localhost")
    listener = Listener()
    with (
        Link(LinkOptions(listen=[endpoint], zenoh=listening)) as publisher,
        Link(LinkOptions(connect=[endpoint], zenoh=connecting)) as subscriber,
    ):
        publisher.advertise(CHANNEL)
        subscriber.subscribe(CHANNEL, listener)
        yield listener, publisher, subscriber


def assert_heard(*ends: Any) -> None:
    with listened(*ends) as (listener, publisher, subscriber):
        assert listener.first.wait(60)
        until(lambda: publisher.peers() == subscriber.peers() == 1)


def assert_refused(*ends: Any) -> None:
    with listened(*ends) as (listener, publisher, subscriber):
        assert not listener.first.wait(REFUSED_S)
        assert publisher.peers() == subscriber.peers() == 0


def test_nothing_listens_beyond_loopback_and_nothing_at_all_unless_asked() -> None:
    def listening() -> set[str]:
        return {
            connection.laddr.ip
            for connection in psutil.Process().net_connections()
            if connection.status == psutil.CONN_LISTEN or connection.type.name == "SOCK_DGRAM"
        }

    before = listening()
    with Link(LinkOptions()):
        assert listening() <= before  # a link of another test may just be closing
    with Link(LinkOptions(listen=[free_endpoint()])):
        assert listening() - before <= {"127.0.0.1"}


def test_two_links_that_were_told_nothing_of_each_other_do_not_meet() -> None:
    with Link(LinkOptions(listen=[free_endpoint()])) as one, Link(LinkOptions()) as other:
        listener = Listener()
        one.advertise(CHANNEL)
        other.subscribe(CHANNEL, listener)
        assert not listener.first.wait(0.5)
        assert one.peers() == other.peers() == 0


@pytest.fixture
def users(tmp_path: Path) -> dict[str, Any]:
    path = tmp_path / "users.txt"
    path.write_text("drone:secret\nground:other\n")
    return {"transport": {"auth": {"usrpwd": {"dictionary_file": str(path)}}}}


def user(name: str, password: str) -> dict[str, Any]:
    return {"transport": {"auth": {"usrpwd": {"user": name, "password": password}}}}


def test_a_user_with_the_right_password_is_heard(users: dict[str, Any]) -> None:
    assert_heard(users, user("drone", "secret"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "credentials",
    [user("drone", "wrong"), user("stranger", "secret"), user("ground", "secret"), {}],
)
def test_a_user_with_wrong_or_no_credentials_is_not(
    users: dict[str, Any], credentials: dict[str, Any]
) -> None:
    assert_refused(users, credentials)


def tls(authority: str, side: str, pair: Any) -> dict[str, Any]:
    keys: dict[str, Any] = {"root_ca_certificate": authority, "enable_mtls": True}
    if pair is not None:
        keys |= {f"{side}_certificate": pair.certificate, f"{side}_private_key": pair.key}
    return {"transport": {"link": {"tls": keys}}}


@pytest.mark.slow
def test_tls_lets_in_the_right_certificate_and_no_other(tmp_path: Path) -> None:
    ours, theirs = Authority(tmp_path, "ours"), Authority(tmp_path, "theirs")
    drone = tls(ours.certificate, "listen", ours.issue("drone"))
    assert_heard(drone, tls(ours.certificate, "connect", ours.issue("ground")), "tls")
    for wrong in (
        tls(ours.certificate, "connect", theirs.issue("ground")),
        tls(theirs.certificate, "connect", ours.issue("ground")),
        tls(ours.certificate, "connect", None),
    ):
        assert_refused(drone, wrong, "tls")


@pytest.mark.slow
@pytest.mark.parametrize(("allowed", "crosses"), [("test/**", True), ("other/**", False)])
def test_access_control_lets_through_the_keys_of_the_file(allowed: str, crosses: bool) -> None:
    rule = {
        "id": "r",
        "permission": "allow",
        "flows": ["ingress", "egress"],
        "messages": ["put", "declare_subscriber"],
        "key_exprs": [allowed],
    }
    settings = {
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": [rule],
            "subjects": [{"id": "all"}],
            "policies": [{"rules": ["r"], "subjects": ["all"]}],
        }
    }
    with listened(settings, {}) as (listener, publisher, subscriber):
        until(lambda: publisher.peers() == subscriber.peers() == 1)
        assert listener.first.wait(60 if crosses else REFUSED_S) is crosses


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (LinkOptions(zenoh={"scouting": {"multicost": True}}), r"zenoh\.scouting\.multicost"),
        (LinkOptions(zenoh={"mode": "router?"}), r"zenoh\.mode cannot be \"router\?\""),
        (LinkOptions(listen=["tcp/256.0.0.1:1"]), r"listening on tcp/256\.0\.0\.1:1"),
        (LinkOptions(listen=["carrier-pigeon"]), "carrier-pigeon"),
    ],
)
def test_a_wrong_setting_or_endpoint_is_named(options: LinkOptions, words: str) -> None:
    with pytest.raises(TransportError, match=words):
        Link(options)


def test_an_endpoint_that_is_taken_is_named() -> None:
    endpoint = free_endpoint()
    with (
        Link(LinkOptions(listen=[endpoint])),
        pytest.raises(TransportError, match=re.escape(endpoint)),
    ):
        Link(LinkOptions(listen=[endpoint]))


@pytest.mark.parametrize("key", ["", "a//b", "a/*", "/a", "a b#?"])
def test_a_key_that_is_none_is_named(key: str) -> None:
    with Link(LinkOptions()) as link, pytest.raises(TransportError, match="no key of a channel"):
        link.advertise(replace(CHANNEL, key=key))


def test_garbage_from_the_network_is_counted_and_what_is_right_still_arrives() -> None:
    endpoint, listener = free_endpoint(), Listener()
    schema = PayloadSchema.of([Box]).hash
    good = pack(Envelope(Kind.BOUND, "camera/out", 1, schema=schema, epoch=1))
    with (
        Link(LinkOptions(listen=[endpoint])) as subscriber,
        Link(LinkOptions(connect=[endpoint])) as publisher,
        zenoh.open(stranger_config(endpoint)) as stranger,
    ):
        subscriber.subscribe(replace(CHANNEL, block=True), listener)
        garbage = stranger.declare_publisher(CHANNEL.key)
        until(lambda: garbage.matching_status.matching)
        for attachment in (None, b"", b"garbage", good[:-1], good + b"x", b"OVF\x63" + bytes(99)):
            garbage.put(b"payload", attachment=attachment)
        garbage.delete()
        until(lambda: sum(refused(subscriber).values()) == 7)
        assert refused(subscriber) == {"malformed": 6, "version": 1}
        publisher.advertise(CHANNEL)
        publisher.publish(CHANNEL.key, envelope(0), box(4))
        until(lambda: listener.arrivals)
        assert listener.arrivals[-1].envelope.epoch > 1


def refused(link: Link) -> dict[str, int]:
    return dict(link.statistics().subscribed[CHANNEL.key].refused)


def stranger_config(endpoint: str) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")  # it leaves files behind
    return config
