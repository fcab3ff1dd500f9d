from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tiny_models import SHAPE, write_tflite

from accelerators.flatbuffer import Table
from accelerators.tflite_file import read_graph


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("flatbuffer") / "tiny.tflite"
    write_tflite(path, operators=2)
    return path.read_bytes()


def test_fields_are_found_by_number_and_have_their_defaults_where_left_out(model: bytes) -> None:
    root = Table.root(model)
    assert root.number(0, "I") == 3  # the schema's version
    (graph,) = root.tables(2)
    assert [tensor.text(3) for tensor in graph.tables(0)] == ["x", "y1", "y2"]
    assert [tensor.numbers(0) for tensor in graph.tables(0)] == [SHAPE] * 3
    assert root.field(99) is None
    assert root.table(99) is None
    assert root.number(99, "i", default=7) == 7
    assert (list(root.tables(99)), root.numbers(99), root.text(99)) == ([], (), "")


@given(data=st.data())
@settings(max_examples=300)
def test_a_damaged_file_is_a_value_error_and_nothing_else(
    model: bytes, data: st.DataObject
) -> None:
    damaged = bytearray(model[: data.draw(st.integers(0, len(model)))])
    for _ in range(data.draw(st.integers(0, 4))):
        if damaged:
            place = data.draw(st.integers(0, len(damaged) - 1))
            damaged[place] = data.draw(st.integers(0, 255))
    with contextlib.suppress(ValueError):
        read_graph(bytes(damaged))


def test_a_file_cut_anywhere_before_its_end_is_recognized_or_whole(
    model: bytes, tmp_path: Path
) -> None:
    whole = read_graph(model)
    for end in range(0, len(model) - 8, 7):
        try:
            assert read_graph(model[:end]) == whole
        except ValueError:
            continue
