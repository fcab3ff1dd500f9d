"""The codec: values arrive as they were sent, and what is none is refused at a bounded cost."""

from __future__ import annotations

import json
import math
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as nps
from wire_payloads import Box, Color, Even, Mode, Scene, Undeclared

from pipeline.errors import WireError
from pipeline.transport.codec import ALIGN, HEADER_BYTES, Encoded, decode, encode
from pipeline.transport.schema import PayloadSchema

SCHEMA = PayloadSchema.of([Scene, Even])
LIMIT = 1 << 20

dtypes = st.one_of(
    nps.boolean_dtypes(),
    nps.integer_dtypes(endianness="?"),
    nps.floating_dtypes(endianness="?"),
    nps.complex_number_dtypes(),
    nps.unicode_string_dtypes(),
    nps.datetime64_dtypes(),
)
arrays = nps.arrays(dtypes, nps.array_shapes(min_dims=0, min_side=0, max_side=4))
scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(),
    st.binary(max_size=200),
    st.sampled_from(list(Color)),
    st.sampled_from(list(Mode)),
    st.builds(np.float32, st.floats(width=32)),
    arrays,
)
keys = st.one_of(st.text(max_size=5), st.integers(), st.sampled_from(list(Mode)))
values = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.lists(inner, max_size=4).map(tuple),
        st.dictionaries(keys, inner, max_size=4),
        st.builds(Box, corners=arrays, label=st.text(max_size=5), color=st.sampled_from(Color)),
    ),
    max_leaves=12,
)


def same(one: Any, other: Any) -> bool:
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray | np.generic):
        return bool(
            one.dtype == other.dtype
            and one.shape == other.shape
            and np.asarray(one).tobytes() == np.asarray(other).tobytes()
        )
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict):
        return same(list(one.items()), list(other.items()))
    if isinstance(one, Box | Scene | Even):
        names = type(one).__dataclass_fields__
        return all(same(getattr(one, name), getattr(other, name)) for name in names)
    return bool(one == other or (one != one and other != other))


def through(encoded: Encoded) -> Any:
    whole = np.frombuffer(encoded.tobytes(), np.uint8)
    return decode(encoded.header, whole[len(encoded.header) :], SCHEMA)


@given(value=values)
def test_a_value_arrives_as_it_was_sent_whole_and_by_slot(value: Any) -> None:
    encoded = encode(value, SCHEMA, LIMIT)
    assert same(through(encoded), value)
    slot = np.empty(encoded.size, np.uint8)
    encoded.write_into(slot)
    assert same(decode(encoded.header, slot, SCHEMA), value)


def test_a_dataclass_arrives_with_what_it_holds_and_computes_the_rest_itself() -> None:
    box = Box(np.arange(4, dtype=np.float32), "car", Color.GREEN)
    scene = Scene((box, box), Mode.HOVER, None, {"cars": 2}, b"\0\1")
    arrived = through(encode(scene, SCHEMA, LIMIT))
    assert same(arrived, scene)
    assert arrived.total == 2


@pytest.mark.parametrize(
    "array",
    [
        np.arange(24, dtype=np.int16).reshape(2, 3, 4).transpose(2, 0, 1),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.arange(10)[::-2],
        np.broadcast_to(np.float32(3), (5, 5)),
    ],
)
def test_an_array_of_any_layout_arrives(array: np.ndarray) -> None:
    assert same(through(encode(array, SCHEMA, LIMIT)), array)


def test_arrays_are_aligned_and_read_only() -> None:
    value = (np.ones(3, np.uint8), b"x" * 5, np.ones((2, 2)))
    encoded = encode(value, SCHEMA, LIMIT)
    assert all(offset % ALIGN == 0 for offset, _ in encoded.buffers)
    assert len(encoded.header) % ALIGN == 0
    first, _, second = through(encoded)
    assert not first.flags.writeable
    assert not second.flags.writeable
    assert second.flags.aligned


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (Undeclared(1), "Undeclared cannot travel.*the graph declares.*annotate"),
        (object(), "object cannot travel"),
        ({1, 2}, "set cannot travel"),
        (np.array([object()]), "dtype object cannot travel"),
        (np.zeros(2, [("x", "f4")]), "cannot travel; use numbers"),
        (np.zeros(LIMIT + 1, np.uint8), "at most 1048576 go .raise max_bytes"),
        (["x" * 100] * (HEADER_BYTES // 100), "header of .*put long lists into arrays"),
        ([10**5000], "cannot travel"),
    ],
)
def test_what_cannot_travel_is_refused_with_the_way_out(value: Any, words: str) -> None:
    with pytest.raises(WireError, match=words):
        encode(value, SCHEMA, LIMIT)


def test_a_value_in_itself_is_refused() -> None:
    endless: list[Any] = []
    endless.append(endless)
    with pytest.raises(WireError, match="nests deeper"):
        encode(endless, SCHEMA, LIMIT)


CLASS = "wire_payloads:"


@pytest.mark.parametrize(
    "node",
    [
        ["a", "<f4", [1 << 60], 0],
        ["a", "<f4", [5], 0],  # 20 of 16 bytes
        ["a", "<f4", [-1], 0],
        ["a", "<f4", [1.5], 0],
        ["a", "<f4", [4], -4],
        ["a", "<f4", [4], 4],
        ["a", "|O", [2], 0],
        ["a", "|O", [0], 0],
        ["a", "<U0", [1 << 40], 0],
        ["a", "nonsense", [1], 0],
        ["a", "<f4", [0, 1 << 62], 0],
        ["a", "<f4", [1] * 200, 0],
        ["t", [["b", 0, 10], ["b", 0, 10]]],  # the same bytes twice
        ["b", 0, 1 << 40],
        ["b", 0, -1],
        ["c", CLASS + "Even", []],
        ["c", CLASS + "Even", [1, 2]],
        ["c", CLASS + "Even", [3]],  # which the class refuses
        ["c", CLASS + "Color", [1]],
        ["c", CLASS + "Undeclared", [1]],
        ["c", "os:system", ["true"]],
        ["c", "builtins:eval", ["1"]],
        ["e", CLASS + "Color", "BLUE"],
        ["e", CLASS + "Even", "number"],
        ["d", [[["l", []], 1]]],  # a list as a key
        ["d", [1]],
        ["x", 1],
        ["a"],
        [],
        {"a": 1},
    ],
)
def test_a_header_that_does_not_describe_its_bytes_is_refused(node: Any) -> None:
    with pytest.raises(WireError):
        decode(json.dumps(node).encode(), np.zeros(16, np.uint8), SCHEMA)


@pytest.mark.parametrize("bracket", [b"[", b'["t",[', b'{"a":'])
def test_deep_nesting_is_refused(bracket: bytes) -> None:
    with pytest.raises(WireError):
        decode(bracket * 50_000, np.zeros(0, np.uint8), SCHEMA)


def test_an_undeclared_class_is_refused_in_words() -> None:
    header = json.dumps(["c", CLASS + "Undeclared", [1]]).encode()
    with pytest.raises(WireError, match="Undeclared arrived where the graph declares") as refusal:
        decode(header, np.zeros(0, np.uint8), SCHEMA)
    assert refusal.value.reason == "schema"


@given(header=st.binary(max_size=200), data=st.binary(max_size=64))
def test_any_bytes_are_a_value_or_a_wire_error(header: bytes, data: bytes) -> None:
    survive(header, data)


@given(
    node=st.recursive(
        st.one_of(
            st.none(),
            st.integers(-3, 70),
            st.floats(),
            st.sampled_from(
                [*"antlbdec", "<f4", "|u1", "<U3", "<M8[ns]", "RED", CLASS + "Box", CLASS + "Color"]
            ),
        ),
        lambda inner: st.lists(inner, max_size=5),
        max_leaves=20,
    ),
    data=st.binary(max_size=64),
)
def test_any_structure_is_a_value_or_a_wire_error(node: Any, data: bytes) -> None:
    survive(json.dumps(node).encode(), data)


@given(data=st.data())
def test_a_good_payload_with_a_piece_replaced_is_a_value_or_a_wire_error(
    data: st.DataObject,
) -> None:
    box = Box(np.arange(4, dtype=np.float32), "car")
    encoded = encode(Scene((box,), Mode.HOVER, None, {}, b"abc"), SCHEMA, LIMIT)
    header = encoded.header.rstrip()
    where = data.draw(st.integers(0, len(header)))
    length = data.draw(st.integers(0, 10))
    put = data.draw(st.one_of(st.binary(max_size=6), st.integers().map(lambda n: b"%d" % n)))
    survive(header[:where] + put + header[where + length :], encoded.tobytes()[-encoded.size :])


def survive(header: bytes, data: bytes) -> None:
    reason = "malformed"
    try:
        decode(header, np.frombuffer(data, np.uint8), SCHEMA)
    except WireError as error:
        reason = error.reason
    assert reason in ("malformed", "schema", "oversized")


def test_reading_allocates_no_more_than_arrived() -> None:
    claims = [["a", "<f8", [1 << n], 0] for n in range(10, 60)]
    tracemalloc.start()
    for claim in claims:
        with pytest.raises(WireError):
            decode(json.dumps(claim).encode(), np.zeros(64, np.uint8), SCHEMA)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 20


def test_numbers_that_json_does_not_have_arrive() -> None:
    arrived = through(encode((math.inf, -math.inf, -0.0), SCHEMA, LIMIT))
    assert arrived[:2] == (math.inf, -math.inf)
    assert math.copysign(1, arrived[2]) == -1
