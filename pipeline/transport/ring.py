"""Large payloads between processes of one host: a ring of slots that its writer owns.

The writer copies a payload into a slot that no reader holds; a reader hands out arrays that lie in
the slot itself and holds it until the last of them is gone. Who holds a slot is not counted in the
memory but known to the kernel, by a lock on one byte of the file (an open-file-description lock):
a reader that is killed holds nothing, and a writer cannot overwrite what is being read. A reader
that is so slow that its slot was written anew before it got there sees another generation: that
message is lost, and counted.

The file is one page of `WORDS` for each slot, and then the slots, page-aligned. A payload larger
than the slots, or no free slot, makes a new file; the old one is removed as soon as its messages
would have been written over, and lives until its last reader lets go.
"""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import struct
import time
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.closing import Closing
from pipeline.errors import TransportError
from pipeline.transport import shared_files
from pipeline.transport.codec import Bytes
from pipeline.transport.envelope import Slot

PAGE = mmap.PAGESIZE
#: Words of 64 bits per slot: generation, state, bytes of its header, bytes of its buffers.
WORDS = 4
MAX_SLOTS = 64  #: of one file
_FILLING, _FILLED, _WITHDRAWN = range(3)
#: How long a reader waits for a writer that has announced a slot and is still filling it.
FILL_S = 2.0
_POLL_S = 20e-6
_FLOCK = struct.Struct("hhqqi4x")
#: The requests to the kernel, by kind of lock and slot.
_REQUESTS = {
    kind: tuple(_FLOCK.pack(kind, os.SEEK_SET, at, 1, 0) for at in range(MAX_SLOTS))
    for kind in (fcntl.F_RDLCK, fcntl.F_WRLCK, fcntl.F_UNLCK)
}


def _lock(descriptor: int, kind: int, at: int) -> bool:
    """Set (or release) the lock of a slot; False where another holds it."""
    try:
        fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, _REQUESTS[kind][at])
    except OSError as error:
        if error.errno not in (errno.EAGAIN, errno.EACCES):
            raise
        return False
    return True


class RingWriter(Closing):
    """The owning end. Not thread-safe."""

    def __init__(self, run: str, *, slots: int, budget: int, folder: Path = shared_files.FOLDER):
        self._run = run
        self._slots = min(max(slots, 2), MAX_SLOTS)
        self._budget = budget  #: bytes that a file may take
        self._folder = folder
        self._file: _File | None = None
        #: Files before this one, which readers may still have to open, each with the generation at
        #: which a ring of its size would have come round.
        self._former: list[tuple[int, _File]] = []
        self._generation = 0
        self._next = 0
        self._claimed = 0

    def claim(self, size: int = 0) -> Slot | None:
        """A slot that nobody reads, for at least `size` bytes of header and buffers (0: of the file
        there is); None where none is free and none can be made. Ends with `fill` or `withdraw`.

        A reader that is told of it now waits until then: the news may travel meanwhile.
        """
        index = self._free(size)
        if index is None:
            return None
        file = self._file
        assert file is not None
        self._next = (index + 1) % file.slots
        self._generation += 1
        while self._former and self._former[0][0] <= self._generation:
            self._former.pop(0)[1].close()
        word = WORDS * index
        file.words[word + 1] = _FILLING
        file.words[word] = self._generation
        self._claimed = index
        return Slot(file.name, index, self._generation)

    def room(self) -> int:
        """Bytes of the slot that is claimed."""
        return 0 if self._file is None else self._file.slot_bytes

    def fill(self, header: bytes, size: int, write: Callable[[Bytes], None]) -> None:
        """Write a payload into the slot that is claimed: `write` its `size` bytes of buffers."""
        file, index = self._file, self._claimed
        assert file is not None
        word, start = WORDS * index, len(header)
        try:
            slot = file.slot(index)
            slot[:start] = np.frombuffer(header, np.uint8)
            write(slot[start : start + size])
        except BaseException:
            self.withdraw()
            raise
        file.words[word + 2], file.words[word + 3] = start, size
        file.words[word + 1] = _FILLED
        _lock(file.descriptor, fcntl.F_UNLCK, index)

    def withdraw(self) -> None:
        """Give back the slot that is claimed; who was told of it is told that nothing came."""
        file, index = self._file, self._claimed
        assert file is not None
        file.words[WORDS * index + 1] = _WITHDRAWN
        _lock(file.descriptor, fcntl.F_UNLCK, index)

    def close(self) -> None:
        """Remove the files; readers keep what they hold."""
        for _, file in self._former:
            file.close()
        self._former.clear()
        if self._file is not None:
            self._file.close()
            self._file = None

    def _free(self, size: int) -> int | None:
        """A slot that nobody reads, locked; makes a new file where there is none."""
        file = self._file
        if file is None and size == 0:
            return None
        if file is not None and size <= file.slot_bytes:
            for step in range(file.slots):
                index = (self._next + step) % file.slots
                if _lock(file.descriptor, fcntl.F_WRLCK, index):
                    return index
            slots, slot_bytes = 2 * file.slots, file.slot_bytes
        else:
            slots = self._slots if file is None else file.slots
            # Clouds differ in size: with room to grow, so that not every larger one makes a file.
            slot_bytes = _pages(size if file is None else size + size // 4)
        if slots > MAX_SLOTS or slots * slot_bytes > self._budget:
            return None
        try:
            new = _File(self._run, slots, slot_bytes, self._folder)
        except TransportError:
            return None  # no room: it goes another way, which its statistics show
        if file is not None:
            self._former.append((self._generation + file.slots, file))
        self._file, self._next = new, 0
        _lock(new.descriptor, fcntl.F_WRLCK, 0)
        return 0


class _File:
    """One file of a ring, mapped and locked by its owner."""

    def __init__(self, run: str, slots: int, slot_bytes: int, folder: Path) -> None:
        self.slots, self.slot_bytes = slots, slot_bytes
        size = PAGE + slots * slot_bytes
        self.name, self.descriptor = shared_files.create(run, size, folder)
        self._path = folder / self.name
        self._memory = mmap.mmap(self.descriptor, size, mmap.MAP_SHARED | mmap.MAP_POPULATE)
        self._bytes = np.frombuffer(self._memory, np.uint8)
        # A memoryview of 64-bit words stores each with one instruction.
        self.words = memoryview(self._memory)[:PAGE].cast("Q")
        self.words[-1] = slot_bytes

    def slot(self, index: int) -> Bytes:
        start = PAGE + index * self.slot_bytes
        return self._bytes[start : start + self.slot_bytes]

    def close(self) -> None:
        self._path.unlink(missing_ok=True)
        self.words.release()
        del self._bytes
        self._memory.close()
        os.close(self.descriptor)


class Reading(NamedTuple):
    """What a reader finds in a slot."""

    header: bytes = b""  #: the codec's
    data: Bytes = np.zeros(0, np.uint8)  #: holds the slot
    withdrawn: bool = False  #: its writer thought better of it: there is no such message


class RingReader:
    """A reading end, of whatever files its writer makes. Not thread-safe."""

    def __init__(self, folder: Path = shared_files.FOLDER) -> None:
        self._folder = folder
        self._view: _View | None = None

    def read(self, slot: Slot) -> Reading | None:
        """What lies in a slot, held as long as an array over it lives; None where it is gone.

        Raises ValueError or OSError for a slot that cannot be.
        """
        view = self._view
        if view is None or view.name != slot.file:
            try:
                view = _View(slot.file, self._folder)
            except FileNotFoundError:
                return None  # its writer has gone on to another file, or away
            self.close()
            self._view = view
        return view.hold(slot)

    def close(self) -> None:
        """Let the file go; what was handed out stays valid."""
        self._view = None


class _View:
    """One file of a ring as a reader maps it: gone with the last array over it."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name = name
        self._descriptor = shared_files.open_to_read(name, folder)
        weakref.finalize(self, os.close, self._descriptor).atexit = False
        self._memory = mmap.mmap(self._descriptor, 0, mmap.MAP_SHARED, mmap.PROT_READ)
        if len(self._memory) < PAGE:
            raise ValueError(f"{name} is no ring")
        self._words = memoryview(self._memory)[:PAGE].cast("Q")
        self._slot_bytes = self._words[-1]
        room = len(self._memory) - PAGE
        self._slots = min(room // self._slot_bytes if self._slot_bytes else 0, MAX_SLOTS)
        self._held: set[int] = set()

    def hold(self, slot: Slot) -> Reading | None:
        at = slot.at
        if at >= self._slots:
            raise ValueError(f"slot {at} lies outside {self.name}")
        if not self._lock_filled(slot):
            return None
        word = WORDS * at
        generation, state, header, size = self._words[word : word + WORDS]
        if generation != slot.generation or state != _FILLED:
            self._release(at)
            withdrawn = generation == slot.generation and state == _WITHDRAWN
            return Reading(withdrawn=True) if withdrawn else None
        if header + size > self._slot_bytes:
            self._release(at)
            raise ValueError(f"{header} + {size} bytes do not fit slot {at} of {self.name}")
        start = PAGE + at * self._slot_bytes
        text = self._memory[start : start + header]
        data = np.frombuffer(self._memory, np.uint8, size, start + header)
        weakref.finalize(data, self._release, at).atexit = False
        return Reading(text, data)

    def _lock_filled(self, slot: Slot) -> bool:
        """Lock the slot for reading, once its writer has filled it."""
        at, until = slot.at, 0.0
        if at in self._held:
            return False  # what we hold cannot have been written anew: this came before
        while not _lock(self._descriptor, fcntl.F_RDLCK, at):
            now = time.monotonic()
            until = until or now + FILL_S
            if now > until or self._words[WORDS * at] != slot.generation:
                return False
            time.sleep(_POLL_S)
        self._held.add(at)
        return True

    def _release(self, at: int) -> None:
        # On whatever thread the last array dies. In this order: once the lock is gone the slot may
        # come again, and must not be found among the held.
        self._held.discard(at)
        _lock(self._descriptor, fcntl.F_UNLCK, at)


def _pages(size: int) -> int:
    return -(-max(size, 1) // PAGE) * PAGE
