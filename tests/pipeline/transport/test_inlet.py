"""The receiving end: what is wrong is counted by its reason, told in words, and never hurts."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from wire_payloads import Box

from pipeline.message import Message
from pipeline.transport.channel import Arrival, Channel, ChannelStatistics
from pipeline.transport.codec import HEADER_BYTES
from pipeline.transport.envelope import Envelope, Kind, Place, Slot, pack, unpack
from pipeline.transport.inlet import Inlet
from pipeline.transport.outlet import INLINE_BYTES, Outlet
from pipeline.transport.schema import PayloadSchema

CHANNEL = Channel(
    "test/camera/out", "camera/out", PayloadSchema.of([Box]), local=False, max_bytes=1 << 20
)
PAYLOAD = Box(np.arange(4, dtype=np.float32), "car")


def sent(count: int, channel: Channel = CHANNEL, corners: int = 4) -> list[tuple[bytes, bytes]]:
    """What an outlet sends of some messages."""
    out: list[tuple[bytes, bytes]] = []
    outlet = Outlet(channel, lambda head, body: out.append((head, body)), run="inlet", epoch=1)
    for number in range(count):
        message = Message.at(number, Box(np.arange(corners, dtype=np.float32), "car"))
        outlet.publish(Envelope.of(message, "camera/out", number + 1), message.payload)
    outlet.close()
    return out


class End:
    """An inlet and what it handed on."""

    def __init__(self, channel: Channel = CHANNEL) -> None:
        self.arrivals: list[Arrival] = []
        self._inlet = Inlet(channel, self.arrivals.append)

    def take(self, head: bytes, body: bytes) -> None:
        self._inlet.take(head, len(body), lambda: body)

    @property
    def books(self) -> ChannelStatistics:
        return self._inlet.statistics()


def changed(head: bytes, **fields: object) -> bytes:
    return pack(unpack(head)._replace(**fields))  # type: ignore[arg-type]


HEAD, BODY = sent(1)[0]
GOOD = unpack(HEAD)


@pytest.mark.parametrize(
    ("head", "body", "reason", "words"),
    [
        (HEAD[:3] + b"\x63" + HEAD[4:], BODY, "version", "version 99 .* install the same"),
        (b"", BODY, "malformed", "no message of Overflight"),
        (HEAD[:-1], BODY, "malformed", "cut short"),
        (HEAD, BODY[:-1], "malformed", "cut short"),
        (HEAD, b"", "malformed", "cut short"),
        (HEAD, BODY + b"\0", "malformed", "cut short"),
        (changed(HEAD, port="lidar/out"), BODY, "channel", "lidar/out came where camera/out"),
        (changed(HEAD, schema=1), BODY, "schema", "same graph file and code"),
        (
            changed(HEAD, place=Place(10, (1 << 20) + 1, (1 << 20) + 1)),
            BODY,
            "oversized",
            "max_bytes",
        ),
        (
            changed(HEAD, place=Place(HEADER_BYTES + 1, 0, 0)),
            bytes(HEADER_BYTES + 1),
            "oversized",
            "at most",
        ),
        (changed(HEAD, place=Place(10, 20, 10)), bytes(20), "malformed", "cut short"),
        (HEAD, b"{" + BODY[1:], "malformed", "not what its header says"),
    ],
)
def test_what_is_wrong_is_refused_counted_and_told(
    head: bytes, body: bytes, reason: str, words: str
) -> None:
    end = End()
    end.take(head, body)
    assert dict(end.books.refused) == {reason: 1}
    assert not end.arrivals
    assert re.search(words, end.books.last_refusal or "")


def test_a_message_that_comes_again_is_refused() -> None:
    end = End()
    messages = sent(3)
    for head, body in [*messages, *messages]:
        end.take(head, body)
    assert end.books.refused == {"replayed": 3}
    assert [each.envelope.number for each in end.arrivals] == [0, 1, 2]


def test_a_message_that_overtook_another_makes_that_one_lost() -> None:
    end = End()
    messages = sent(3)
    for number in (0, 2, 1):
        end.take(*messages[number])
    assert [(each.envelope.number, each.lost) for each in end.arrivals] == [(0, 0), (2, 1)]
    assert (end.books.lost, end.books.refused) == (1, {"replayed": 1})


def test_a_damaged_payload_is_lost_and_told_with_the_next_arrival() -> None:
    end = End()
    messages = sent(3)
    end.take(*messages[0])
    end.take(messages[1][0], b"{" + messages[1][1][1:])
    end.take(*messages[2])
    assert [each.lost for each in end.arrivals] == [0, 1]
    assert end.books.lost == 1


def test_a_payload_whose_slot_was_written_anew_is_lost(tmp_path: Path) -> None:
    channel = replace(CHANNEL, local=True, slots=2)
    out: list[tuple[bytes, bytes]] = []
    outlet = Outlet(
        channel, lambda head, body: out.append((head, body)), run="x", epoch=1, folder=tmp_path
    )
    outlet.repeat()  # the news that it is there
    for number in range(4):
        message = Message.at(number, Box(np.zeros(INLINE_BYTES, np.float32), str(number)))
        outlet.publish(Envelope.of(message, "camera/out", number + 1), message.payload)
    arrivals: list[Arrival] = []
    inlet = Inlet(channel, arrivals.append, folder=tmp_path)
    for head, body in out:
        inlet.take(head, len(body), lambda body=body: body)  # type: ignore[misc]
    assert [each.payload.label for each in arrivals[1:]] == ["2", "3"]
    assert [each.lost for each in arrivals] == [0, 2, 0]
    assert (inlet.statistics().lost, inlet.statistics().refused) == (2, {"gone": 2})
    outlet.close()


@pytest.mark.parametrize("name", ["../../etc/passwd", "overflight-absent", "x" * 300])
def test_a_slot_in_a_file_that_is_none_is_refused(name: str) -> None:
    end = End()
    end.take(changed(HEAD, place=Place(slot=Slot(name, 0, 1))), b"")
    assert sum(end.books.refused.values()) == 1
    end.take(*sent(2)[1])  # the number after it tells that it is lost
    assert end.books.received == 1


def zstd_body(raw: bytes) -> tuple[bytes, bytes]:
    head, body = sent(1, replace(CHANNEL, zstd=1), INLINE_BYTES)[0]
    place = unpack(head).place
    packed = zstandard.compress(raw)
    return changed(head, place=place._replace(stored=len(packed))), body[: place.header] + packed


def test_a_compressed_payload_that_would_grow_beyond_its_size_is_not_unpacked() -> None:
    end = End()
    end.take(*zstd_body(bytes(1 << 24)))
    assert end.books.refused == {"malformed": 1}
    end.take(*zstd_body(b""))
    assert end.books.lost == 1


def test_a_damaged_compressed_payload_is_refused() -> None:
    head, body = sent(1, replace(CHANNEL, zstd=1), INLINE_BYTES)[0]
    end = End(replace(CHANNEL, zstd=1))
    end.take(head, body[:-40] + bytes(40))
    assert end.books.refused == {"malformed": 1}


@given(head=st.binary(max_size=200), body=st.binary(max_size=200))
def test_any_bytes_are_counted_and_never_hurt(head: bytes, body: bytes) -> None:
    end = End()
    for prefix in (b"", HEAD[:4], HEAD[:60], HEAD):
        end.take(prefix + head, body)
        end.take(prefix, body)
    assert sum(end.books.refused.values()) + end.books.received == 8


@given(data=st.data())
def test_a_good_message_with_a_piece_replaced_is_a_message_or_counted(data: st.DataObject) -> None:
    head, body = (
        text[:where] + data.draw(st.binary(max_size=8)) + text[where + cut :]
        for text in (HEAD, BODY)
        for where in [data.draw(st.integers(0, len(text)))]
        for cut in [data.draw(st.integers(0, 8))]
    )
    end = End()
    end.take(head, body)
    assert len(end.arrivals) + sum(end.books.refused.values()) == 1


def test_news_carry_no_payload() -> None:
    end = End()
    news = Envelope(Kind.BOUND, "camera/out", 5, schema=CHANNEL.schema.hash, epoch=1)
    end.take(pack(news), b"")
    end.take(pack(news), b"surprise")
    assert [each.envelope.bound for each in end.arrivals] == [5]
    assert end.books.refused == {"malformed": 1}
