"""The ring: what is read stays as it is, what was overwritten is gone, the dead hold nothing."""

from __future__ import annotations

import gc
import os
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from descriptors import descriptors
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.transport import ring as module
from pipeline.transport.codec import Bytes
from pipeline.transport.envelope import Slot
from pipeline.transport.ring import MAX_SLOTS, PAGE, Reading, RingReader, RingWriter
from pipeline.transport.shared_files import sweep

HERE = Path(__file__).parent


def write(ring: RingWriter, size: int, value: int) -> Slot | None:
    slot = ring.claim(size)
    if slot is not None:
        ring.fill(b"", size, lambda target: target.fill(value))
    return slot


def read(reader: RingReader, slot: Slot | None) -> Bytes | None:
    reading = reader.read(must(slot))
    return None if reading is None else reading.data


def must(slot: Slot | None) -> Slot:
    assert slot is not None
    return slot


@pytest.fixture
def ring(tmp_path: Path) -> Iterator[RingWriter]:
    with RingWriter("test", slots=2, budget=16 * PAGE, folder=tmp_path) as ring:
        yield ring


@pytest.fixture
def reader(tmp_path: Path) -> RingReader:
    return RingReader(tmp_path)


def test_a_payload_is_read_as_it_was_written_and_only_to_read(
    ring: RingWriter, reader: RingReader
) -> None:
    slot = must(write(ring, 1000, 7))
    data = read(reader, slot)
    assert data is not None
    assert data.tolist() == [7] * 1000
    assert not data.flags.writeable
    with pytest.raises(ValueError, match="WRITEABLE"):
        data.flags.writeable = True


def test_what_a_reader_holds_is_not_overwritten(ring: RingWriter, reader: RingReader) -> None:
    held = read(reader, write(ring, 100, 1))
    for value in range(2, 40):
        write(ring, 100, value)
    assert held is not None
    assert set(held.tolist()) == {1}


def test_a_view_of_a_payload_holds_its_slot_and_its_end_frees_it(
    ring: RingWriter, reader: RingReader
) -> None:
    slot = must(write(ring, 100, 1))
    data = read(reader, slot)
    assert data is not None
    part = data[10:20].view(np.uint16)
    del data
    assert [must(write(ring, 100, n)).at for n in range(3)] == [1, 1, 1]
    del part
    assert slot.at in [must(write(ring, 100, n)).at for n in range(2)]


def test_a_slot_that_was_written_anew_is_gone(ring: RingWriter, reader: RingReader) -> None:
    first = must(write(ring, 100, 1))
    for value in range(2):
        write(ring, 100, value)
    assert read(reader, first) is None


def test_where_all_slots_are_held_the_ring_grows_to_its_budget_and_then_refuses(
    ring: RingWriter, reader: RingReader
) -> None:
    held: list[Bytes | None] = []
    names = set()
    while (slot := write(ring, PAGE, len(held))) is not None:
        names.add(slot.file)
        held.append(read(reader, slot))
        assert len(held) < 100
    assert [int(data[0]) for data in held if data is not None] == list(range(len(held)))
    assert len(names) == 4  # 2, 4, 8, 16 slots
    assert len(held) == 2 + 4 + 8 + 16
    held.clear()
    assert write(ring, PAGE, 1) is not None


def test_a_payload_larger_than_the_slots_makes_a_new_file_and_the_old_is_soon_removed(
    ring: RingWriter, reader: RingReader, tmp_path: Path
) -> None:
    small = must(write(ring, 10, 1))
    held = read(reader, small)
    large = must(write(ring, 3 * PAGE, 2))
    assert large.file != small.file
    unread = must(small)
    assert read(RingReader(tmp_path), unread) is not None  # who has not come to it yet still may
    write(ring, 3 * PAGE, 3)
    assert [path.name for path in tmp_path.iterdir()] == [large.file]
    data = read(reader, large)
    assert data is not None
    assert data.sum() == 2 * 3 * PAGE
    assert held is not None
    assert held.sum() == 10


def test_a_payload_over_the_budget_is_refused_and_costs_nothing(
    ring: RingWriter, tmp_path: Path
) -> None:
    assert write(ring, 17 * PAGE, 1) is None
    assert not list(tmp_path.iterdir())


def test_without_room_for_a_file_it_is_refused(tmp_path: Path) -> None:
    with RingWriter("test", slots=2, budget=1 << 60, folder=tmp_path) as ring:
        assert write(ring, 1 << 50, 1) is None


def test_a_slot_that_is_claimed_is_waited_for_until_it_is_filled(
    ring: RingWriter, reader: RingReader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "FILL_S", 60.0)  # this thread may stand still for a while
    slot = must(ring.claim(100))
    found: list[Reading | None] = []
    thread = threading.Thread(target=lambda: found.append(reader.read(slot)))
    thread.start()
    ring.fill(b"header", 100, lambda target: target.fill(9))
    thread.join()
    assert found[0] is not None
    assert found[0].header == b"header"
    assert found[0].data.tolist() == [9] * 100


def test_a_slot_that_is_withdrawn_says_so_and_is_free_again(
    ring: RingWriter, reader: RingReader
) -> None:
    slot = must(ring.claim(100))
    ring.withdraw()
    reading = reader.read(slot)
    assert reading is not None
    assert reading.withdrawn
    assert [must(write(ring, 100, n)).at for n in range(3)] == [1, 0, 1]


def test_a_payload_whose_writer_failed_is_withdrawn(ring: RingWriter, reader: RingReader) -> None:
    def fail(target: Bytes) -> None:
        raise ZeroDivisionError

    slot = must(ring.claim(100))
    with pytest.raises(ZeroDivisionError):
        ring.fill(b"", 100, fail)
    reading = reader.read(slot)
    assert reading is not None
    assert reading.withdrawn
    assert write(ring, 100, 1) is not None


def test_a_slot_that_is_claimed_without_a_size_is_of_the_file_there_is(
    ring: RingWriter, reader: RingReader
) -> None:
    assert ring.room() == 0
    assert ring.claim() is None
    write(ring, 2 * PAGE, 1)
    assert ring.claim() is not None
    assert ring.room() == 2 * PAGE
    ring.withdraw()


@pytest.mark.parametrize("at", [MAX_SLOTS, 2, 1 << 31])
def test_a_slot_that_lies_outside_the_file_is_refused(
    ring: RingWriter, reader: RingReader, at: int
) -> None:
    slot = must(write(ring, 10, 1))
    with pytest.raises(ValueError, match="outside"):
        reader.read(Slot(slot.file, at, slot.generation))


@pytest.mark.parametrize(("header", "size"), [(0, PAGE + 1), (PAGE, 1), (1 << 62, 1 << 62)])
def test_sizes_that_do_not_fit_their_slot_are_refused(
    ring: RingWriter, reader: RingReader, tmp_path: Path, header: int, size: int
) -> None:
    slot = must(write(ring, 10, 1))
    with (tmp_path / slot.file).open("r+b") as file:
        file.seek(16)
        file.write(struct.pack("<QQ", header, size))
    with pytest.raises(ValueError, match="do not fit"):
        reader.read(slot)
    assert must(write(ring, 10, 2))


def test_a_file_that_is_gone_is_no_error(reader: RingReader) -> None:
    assert reader.read(Slot("overflight-x", 0, 1)) is None


@pytest.mark.parametrize("size", [0, 100])
def test_a_file_that_is_no_ring_is_refused(reader: RingReader, tmp_path: Path, size: int) -> None:
    (tmp_path / "overflight-x").write_bytes(bytes(size))
    with pytest.raises(ValueError, match=r"empty|no ring"):
        reader.read(Slot("overflight-x", 0, 1))


def test_both_ends_leave_no_file_no_descriptor_and_no_mapping(tmp_path: Path) -> None:
    def resources() -> tuple[int, int]:
        """Descriptors and mappings of files in this folder: those of others come and go."""
        gc.collect()
        maps = Path("/proc/self/maps").read_text()
        return descriptors(str(tmp_path)).total(), maps.count(str(tmp_path))

    for number in range(10):
        with RingWriter("test", slots=2, budget=1 << 20, folder=tmp_path) as ring:
            reader = RingReader(tmp_path)
            held = [read(reader, write(ring, size, 1)) for size in (10, 9000, 20_000)]
            reader.close()
        assert all(data is not None and data[0] == 1 for data in held)
        if number == 0:
            assert min(resources()) > 0, "what is held is not seen"
        held.clear()
    assert resources() == (0, 0)
    assert not list(tmp_path.iterdir())


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    max_examples=60,
)
@given(steps=st.lists(st.tuples(st.sampled_from("wrd"), st.integers(0, 5)), max_size=60))
def test_whatever_is_read_when_it_is_whole_or_gone(
    tmp_path: Path, steps: list[tuple[str, int]]
) -> None:
    with RingWriter("test", slots=2, budget=64 * PAGE, folder=tmp_path) as ring:
        reader = RingReader(tmp_path)
        sent: list[tuple[int, Slot]] = []
        held: list[tuple[int, Bytes]] = []
        for number, (step, which) in enumerate(steps):
            if step == "w" and (slot := write(ring, 50 + 1000 * which, number)):
                sent.append((number, slot))
            elif step == "r" and len(sent) > which:
                value, slot = sent.pop(-1 - which)
                if (data := read(reader, slot)) is not None:
                    held.append((value, data))
            elif step == "d" and len(held) > which:
                del held[which]
            assert all(set(data.tolist()) == {value} for value, data in held)


@contextmanager
def process(*words: object) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [sys.executable, str(HERE / "ring_owner.py"), *map(str, words)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(HERE.parents[2])},
    ) as child:
        try:
            yield child
        finally:
            child.kill()


def line(child: subprocess.Popen[str]) -> str:
    assert child.stdout is not None
    return child.stdout.readline().strip()


def test_a_killed_reader_holds_nothing(ring: RingWriter, tmp_path: Path) -> None:
    slot = must(write(ring, 100, 3))
    with process("read", tmp_path, *slot) as child:
        assert line(child) == "300"
        assert [must(write(ring, 100, n)).at for n in range(3)] == [1, 1, 1]
        child.kill()
        child.wait()
        assert slot.at in [must(write(ring, 100, n)).at for n in range(2)]


def test_the_file_of_a_killed_writer_is_swept_and_what_was_read_stays(tmp_path: Path) -> None:
    with process("write", tmp_path, "", "", "") as child:
        file, at, generation = line(child).split()
        reader = RingReader(tmp_path)
        assert line(child) == "filled"
        data = read(reader, Slot(file, int(at), int(generation)))
        assert sweep(folder=tmp_path) == []
        child.kill()
        child.wait()
    assert sweep(folder=tmp_path) == [file]
    assert data is not None
    assert data.sum() == 700
