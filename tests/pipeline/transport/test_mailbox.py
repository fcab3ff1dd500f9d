"""Mailboxes: arrays arrive as they were sent, and what is wrong closes the box."""

from __future__ import annotations

import json
import socket

import numpy as np
import pytest
from descriptors import descriptors
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as nps

from pipeline.transport.mailbox import HEADER_BYTES, Closed, Mailbox

KINDS = st.sampled_from(["uint8", "int8", "float32", "float16", "int64", "bool"])
ARRAYS = KINDS.flatmap(lambda kind: nps.arrays(kind, nps.array_shapes(min_dims=0, min_side=0)))


def pair() -> tuple[Mailbox, Mailbox]:
    one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    return Mailbox(one), Mailbox(other)


@given(packets=st.lists(st.dictionaries(st.text(max_size=5), ARRAYS, max_size=3), max_size=6))
def test_arrays_arrive_as_they_were_sent(packets: list[dict[str, np.ndarray]]) -> None:
    one, other = pair()
    for number, arrays in enumerate(packets):
        one.send({"number": number}, arrays)
        header, received = other.receive()
        assert header == {"number": number}
        assert received.keys() == arrays.keys()
        for name, array in arrays.items():
            assert received[name].dtype == array.dtype
            np.testing.assert_array_equal(received[name], array)
    one.close()
    other.close()


def test_what_was_received_does_not_change_with_the_next_packet() -> None:
    one, other = pair()
    one.send({}, {"x": np.zeros(100)})
    _, first = other.receive()
    one.send({}, {"x": np.ones(100)})
    other.receive()
    assert not first["x"].any()
    one.close()
    other.close()


def test_both_ends_leave_no_descriptor_behind() -> None:
    before = descriptors()
    for _ in range(20):
        one, other = pair()
        for size in (10, 10_000, 1_000_000):
            one.send({}, {"x": np.zeros(size, np.uint8)})
            other.receive()
            other.send({}, {"y": np.zeros(size, np.uint8)})
            one.receive()
        one.close()
        other.close()
    assert not descriptors() - before


def test_the_end_of_the_other_side_is_closed_to_sender_and_receiver() -> None:
    one, other = pair()
    other.close()
    with pytest.raises(Closed):
        one.receive()
    with pytest.raises(Closed):
        one.send({"a": 1})
    one.close()


def test_a_header_that_does_not_fit_is_refused_before_it_is_sent() -> None:
    one, other = pair()
    with pytest.raises(ValueError, match="header"):
        one.send({"text": "x" * HEADER_BYTES})
    one.close()
    other.close()


@pytest.mark.parametrize(
    "layout",
    [
        {"x": ["<f4", [10**12], 0]},
        {"x": ["<f4", [-1], 0]},
        {"x": ["<f4", [4], 10**9]},
        {"x": ["<f4", [4], -4]},
        {"x": ["|O", [4], 0]},
        {"x": ["no type", [4], 0]},
        {"x": [1]},
        ["x"],
    ],
)
def test_a_layout_outside_the_memory_closes_the_box_and_allocates_nothing(layout: object) -> None:
    raw, end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    box, sender = Mailbox(end), Mailbox(raw)
    sender.send({}, {"x": np.zeros(4, np.float32)})
    box.receive()
    raw.send(json.dumps({"arrays": layout}).encode())
    with pytest.raises(Closed):
        box.receive()
    box.close()
    sender.close()


@given(packet=st.binary(min_size=1, max_size=200))
def test_bytes_that_are_no_header_close_the_box(packet: bytes) -> None:
    raw, end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with raw:
        raw.send(packet)
        box = Mailbox(end)
        with pytest.raises(Closed):
            box.receive()
        box.close()
