"""MCAP files come back as they were written, also those that a crash has cut short."""

from __future__ import annotations

import random
from collections.abc import Sequence
from pathlib import Path

import pytest

from pipeline.errors import DataError
from pipeline.recording.codec import Schema
from pipeline.recording.mcap import CHUNK_BYTES, MAGIC, McapReader, McapWriter, Record

TEXT = Schema("text", "jsonschema", b"{}", "json")


def message(topic: str, number: int) -> bytes:
    return f"{topic} {number} ".encode() * (CHUNK_BYTES // 64)


def write(path: Path, count: int, topics: Sequence[str] = ("a", "b")) -> None:
    with McapWriter(path) as file:
        for topic in topics:
            file.add_channel(topic, TEXT, {"payload": topic.upper()})
        for number in range(count):
            for topic in topics:
                stamp = 10 * number
                file.write(topic, message(topic, number), received=stamp + 3, stamp=stamp)
        file.note("made", {"by": "a test"})


def noise(number: int) -> bytes:
    """Half a chunk that cannot be compressed, so that chunks are as large as they say."""
    return random.Random(number).randbytes(CHUNK_BYTES // 2)


def write_noise(path: Path, count: int) -> None:
    with McapWriter(path) as file:
        file.add_channel("a", TEXT)
        for number in range(count):
            file.write("a", noise(number), received=number, stamp=number)


def test_messages_come_back_by_topic_in_order_with_their_times(tmp_path: Path) -> None:
    write(tmp_path / "f.mcap", 20)
    reader = McapReader(tmp_path / "f.mcap")
    expected = [Record("b", 10 * n + 3, 10 * n, n, message("b", n)) for n in range(20)]
    assert list(reader.records(["b"])) == expected
    assert {record.topic for record in reader.records(["a", "b"])} == {"a", "b"}
    assert list(reader.records(["c"])) == []


def test_a_file_says_what_it_holds(tmp_path: Path) -> None:
    write(tmp_path / "f.mcap", 20)
    channels = McapReader(tmp_path / "f.mcap").channels()
    assert {topic: channel.count for topic, channel in channels.items()} == {"a": 20, "b": 20}
    assert channels["a"].schema == "text"
    assert channels["a"].metadata == {"payload": "A"}
    assert McapReader(tmp_path / "f.mcap").notes() == {"made": {"by": "a test"}}


@pytest.mark.parametrize("part", [0.999, 0.7, 0.3])
def test_a_file_that_was_cut_short_is_read_up_to_its_last_whole_chunk(
    tmp_path: Path, part: float
) -> None:
    whole, cut = tmp_path / "whole.mcap", tmp_path / "cut.mcap"
    write_noise(whole, 12)
    content = whole.read_bytes()
    cut.write_bytes(content[: int(part * len(content))])
    reader = McapReader(cut)
    assert not reader.is_whole()
    assert list(reader.channels()) == ["a"]
    records = list(reader.records(["a"]))
    assert records == list(McapReader(whole).records(["a"]))[: len(records)]
    lost = 12 - len(records) - (1 - part) * 12
    assert 0 <= lost + 1 <= 4, "more than the last chunks are missing"
    assert reader.notes() == {}


def test_what_was_written_is_in_the_file_before_it_is_closed(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    with McapWriter(path) as file:
        file.add_channel("a", TEXT)
        for number in range(8):
            file.write("a", noise(number), received=number, stamp=number)
        assert len(list(McapReader(path).records(["a"]))) >= 6


def write_and_stop(path: Path) -> None:
    with McapWriter(path) as file:
        file.add_channel("a", TEXT)
        file.write("a", b"1", received=1, stamp=1)
        raise KeyboardInterrupt


def test_a_block_that_raises_still_leaves_a_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    with pytest.raises(KeyboardInterrupt):
        write_and_stop(path)
    assert McapReader(path).is_whole()
    assert len(list(McapReader(path).records(["a"]))) == 1


def test_a_damaged_chunk_is_told_and_not_read(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    write_noise(path, 12)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"f\.mcap: damaged"):
        list(McapReader(path).records(["a"]))


@pytest.mark.parametrize("content", [b"", b"no", b"\x89PNG and so on" * 9])
def test_another_file_is_no_mcap_file(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "f.mcap").write_bytes(content)
    with pytest.raises(DataError, match="not an MCAP file"):
        McapReader(tmp_path / "f.mcap").channels()


def test_a_file_of_nothing_but_its_beginning_holds_nothing(tmp_path: Path) -> None:
    (tmp_path / "f.mcap").write_bytes(MAGIC)
    assert McapReader(tmp_path / "f.mcap").channels() == {}


def test_a_file_that_cannot_be_opened_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"cannot read .*none\.mcap"):
        McapReader(tmp_path / "none.mcap").channels()
    with pytest.raises(DataError, match=r"cannot write .*no/f"), McapWriter(tmp_path / "no" / "f"):
        pass
