"""Whatever a file holds, reading it gives records or a DataError."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.errors import DataError
from pipeline.recording.codec import Schema
from pipeline.recording.mcap import McapReader, McapWriter

quick = settings(
    max_examples=150,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="module")
def good(folder: Path) -> bytes:
    path = folder / "good.mcap"
    with McapWriter(path) as writer:
        for topic in ("image", "scan"):
            writer.add_channel(topic, Schema("test", "jsonschema", b"{}", "json"), {"a": "b"})
        for number in range(20):
            writer.write(
                ("image", "scan")[number % 2], b'{"n": %d}' % number, received=number, stamp=number
            )
        writer.note("versions", {"overflight": "1"})
    return path.read_bytes()


def survive(folder: Path, data: bytes) -> None:
    path = folder / "any.mcap"
    path.write_bytes(data)
    reader = McapReader(path)
    for read in (reader.channels, reader.notes, lambda: list(reader.records(["image", "scan"]))):
        sentence = "none"
        try:
            read()
        except DataError as error:
            sentence = str(error)
        assert sentence


@quick
@given(data=st.binary(max_size=300))
def test_any_bytes_are_a_recording_or_a_data_error(folder: Path, good: bytes, data: bytes) -> None:
    survive(folder, data)
    survive(folder, good[:8] + data)
    survive(folder, good[:8] + data + good[-8:])


@quick
@given(data=st.data())
def test_a_recording_cut_anywhere_is_read_up_to_there(
    folder: Path, good: bytes, data: st.DataObject
) -> None:
    survive(folder, good[: data.draw(st.integers(0, len(good)))])


@quick
@given(data=st.data())
def test_a_recording_with_a_piece_replaced_is_one_or_a_data_error(
    folder: Path, good: bytes, data: st.DataObject
) -> None:
    where = data.draw(st.integers(0, len(good)))
    length = data.draw(st.integers(0, 9))
    survive(folder, good[:where] + data.draw(st.binary(max_size=9)) + good[where + length :])
