"""Envelopes: every field arrives, and bytes that are none are refused in words."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import WireError
from pipeline.message import Message, Sample
from pipeline.transport.envelope import (
    MAX_SAMPLES,
    NO_BOUND,
    VERSION,
    Envelope,
    Kind,
    Place,
    Slot,
    pack,
    unpack,
)

times = st.integers(-(1 << 62), 1 << 62)
words = st.integers(0, (1 << 64) - 1)
names = st.text(st.characters(codec="utf-8"), max_size=20)
samples = st.builds(Sample, names, times, times)
slots = st.builds(Slot, names, st.integers(0, 99), words)
places = st.builds(
    Place, st.integers(0, 1 << 20), words, words, st.none() | slots, zstd=st.booleans()
)
envelopes = st.builds(
    Envelope,
    st.sampled_from(Kind),
    names,
    times,
    times,
    times,
    times,
    times,
    times,
    st.lists(samples, max_size=5).map(tuple),
    st.none() | names,
    st.booleans(),
    words,
    words,
    words,
    places,
)
GOOD = Envelope(Kind.MESSAGE, "camera/out", 7, 5, 4, 6, 5, 3, (Sample("camera/out", 5, 5),), "cpu")


@given(envelope=envelopes)
def test_every_field_arrives_as_it_was_sent(envelope: Envelope) -> None:
    assert unpack(pack(envelope)) == envelope


def test_a_message_is_the_same_on_the_other_side() -> None:
    message = Message(b"x", 10, 9, 12, 13, 4, (Sample("lidar/out", 9, 11),), "igpu", degraded=True)
    envelope = unpack(pack(Envelope.of(message, "fuse/out", 11)))
    arrived = envelope.message(b"x")
    assert all(
        getattr(arrived, name) == getattr(message, name) for name in Message.__dataclass_fields__
    )
    assert (envelope.port, envelope.bound, envelope.kind) == ("fuse/out", 11, Kind.MESSAGE)


def test_an_envelope_is_small() -> None:
    assert len(pack(Envelope(Kind.BOUND, "camera/out", NO_BOUND))) < 128


@pytest.mark.parametrize("length", range(len(pack(GOOD))))
def test_an_envelope_cut_short_is_refused(length: int) -> None:
    with pytest.raises(WireError):
        unpack(pack(GOOD)[:length])


def test_an_envelope_with_bytes_after_it_is_refused() -> None:
    with pytest.raises(WireError, match="after its end"):
        unpack(pack(GOOD) + b"\0")


def test_another_version_is_refused_with_both_and_the_way_out() -> None:
    other = bytearray(pack(GOOD))
    other[3] = VERSION + 1
    with pytest.raises(
        WireError, match=f"version {VERSION + 1} .* this one {VERSION}; install"
    ) as refusal:
        unpack(bytes(other))
    assert refusal.value.reason == "version"


def test_what_is_no_envelope_at_all_is_refused_with_a_hint() -> None:
    with pytest.raises(WireError, match="no message of Overflight"):
        unpack(b"GET / HTTP/1.1")


@given(where=st.integers(0, len(pack(GOOD))), length=st.integers(0, 9), put=st.binary(max_size=9))
def test_a_good_envelope_with_a_piece_replaced_is_one_or_a_wire_error(
    where: int, length: int, put: bytes
) -> None:
    good = pack(GOOD)
    survive(good[:where] + put + good[where + length :])


@given(data=st.binary(max_size=300))
def test_any_bytes_are_an_envelope_or_a_wire_error(data: bytes) -> None:
    survive(data)
    survive(b"OVF" + bytes([VERSION]) + data)


def survive(data: bytes) -> None:
    reason = "malformed"
    try:
        unpack(data)
    except WireError as error:
        reason = error.reason
    assert reason in ("malformed", "version")


@pytest.mark.parametrize(
    "envelope",
    [
        GOOD._replace(stamp=1 << 70),
        GOOD._replace(port="x" * 70_000),
        GOOD._replace(lineage=GOOD.lineage * (MAX_SAMPLES + 1)),
    ],
)
def test_what_does_not_fit_an_envelope_is_refused(envelope: Envelope) -> None:
    with pytest.raises(WireError, match=r"camera/out|x"):
        pack(envelope)
