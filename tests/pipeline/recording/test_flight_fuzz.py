"""A damaged recording is an error with a way out: no traceback, no memory beyond the file's own."""

from __future__ import annotations

import struct
import tracemalloc
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import zstandard
from driving import Collect, Pair, beat, drive
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from recording_runs import NumberCodecs, recorder, rewrite, topology

from pipeline.errors import DataError
from pipeline.recording.explanation import explain
from pipeline.recording.flight import Flight
from pipeline.recording.mcap import MAGIC, McapReader, Record
from pipeline.recording.outline import Outline
from pipeline.recording.payloads import Payloads
from pipeline.recording.recorder import DECISIONS
from pipeline.scheduling.topology import Port

SOURCES = (Port("lidar"), Port("camera"))


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flight") / "f.mcap"
    of = topology()
    with recorder(path, of, compression="none") as kept:
        sources = {"lidar": beat(12, 10), "camera": beat(6, 20)}
        stages = {"fuse": Pair(), "sink": Collect()}
        drive(of.stages, stages, sources, live=False, recorder=kept)
    return path


def read_everything(path: Path) -> None:
    """All that `info`, `explain` and a replay ask of a file."""
    flight = Flight(path)
    assert flight.manifest
    flight.channels  # noqa: B018  # reads them
    Outline.of(flight, SOURCES)
    explain(flight, "fuse")
    payloads = Payloads(flight, SOURCES, NumberCodecs())
    try:
        for number in range(12):
            payloads.take(Port("lidar"), number * 10_000_000)
    finally:
        payloads.close()


def test_the_good_file_is_read(good: Path) -> None:
    read_everything(good)


@given(data=st.data())
def test_a_file_that_was_cut_or_changed_is_read_or_refused(good: Path, data: Any) -> None:
    whole = good.read_bytes()
    kept = data.draw(st.one_of(st.just(len(whole)), st.integers(0, len(whole))))
    changed = bytearray(whole[:kept])
    for _ in range(data.draw(st.integers(0, 3))):
        if changed:
            place = data.draw(st.integers(0, len(changed) - 1))
            changed[place] ^= data.draw(st.integers(1, 255))
    path = good.with_name("changed.mcap")
    path.write_bytes(changed)
    refused_or_read(path)


@given(data=st.data())
def test_a_chunk_that_is_sound_and_says_nonsense_is_read_or_refused(good: Path, data: Any) -> None:
    def change(entry: Record) -> Record:
        if entry.topic != DECISIONS:
            return entry
        text = bytearray(entry.data)
        for _ in range(data.draw(st.integers(1, 3))):
            place = data.draw(st.integers(0, len(text) - 1))
            text[place : place + data.draw(st.integers(0, 5))] = data.draw(NONSENSE)
        return replace(entry, data=bytes(text))

    path = good.with_name("nonsense.mcap")
    path.write_bytes(good.read_bytes())
    rewrite(path, change)
    refused_or_read(path)


#: What JSON knows, and numbers that no flight has.
NONSENSE = st.sampled_from(
    [
        b"",
        b"0",
        b"-1",
        b"1e999",
        b"NaN",
        b"9" * 30,
        b"[",
        b"]",
        b"{}",
        b"null",
        b'"',
        b'"out"',
        b",",
    ]
)


def refused_or_read(path: Path) -> None:
    with suppress(DataError):
        read_everything(path)


@given(st.binary(max_size=400), st.booleans())
def test_garbage_is_refused(good: Path, garbage: bytes, magic: bool) -> None:
    path = good.with_name("garbage.mcap")
    path.write_bytes((MAGIC if magic else b"") + garbage)
    with pytest.raises(DataError, match=r"garbage\.mcap"):
        read_everything(path)


def chunk(compression: str, data: bytes, size: int) -> bytes:
    """A chunk record as it stands in a file."""
    name = compression.encode()
    body = struct.pack("<QQQI", 0, 0, size, 0)
    body += struct.pack("<I", len(name)) + name + struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", Opcode.CHUNK, len(body)) + body


ZEROS = bytes(64 << 20)


@pytest.mark.parametrize(
    ("compression", "data", "size"),
    [
        ("zstd", zstandard.compress(ZEROS), 1_000),
        ("zstd", zstandard.compress(ZEROS), 1 << 40),
        ("lz4", lz4.frame.compress(ZEROS), 1_000),
        ("lz4", lz4.frame.compress(ZEROS), 1 << 40),
        ("", b"12", 1 << 62),
    ],
)
def test_a_chunk_that_would_unpack_to_more_than_it_says_is_not_unpacked(
    tmp_path: Path, compression: str, data: bytes, size: int
) -> None:
    path = tmp_path / "bomb.mcap"
    header = struct.pack("<BQ", Opcode.HEADER, 8) + bytes(8)
    path.write_bytes(MAGIC + header + chunk(compression, data, size))
    tracemalloc.start()
    try:
        assert list(McapReader(path).records(["a"])) == []
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 8 << 20


def test_a_record_that_says_it_is_endless_allocates_nothing(tmp_path: Path) -> None:
    path = tmp_path / "endless.mcap"
    path.write_bytes(MAGIC + struct.pack("<BQ", Opcode.CHUNK, 1 << 62) + bytes(100))
    tracemalloc.start()
    try:
        assert list(McapReader(path).records(["a"])) == []
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 8 << 20
