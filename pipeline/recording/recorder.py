"""Writes a flight while it flies: messages, hashes and decisions, and never in its way.

The driver's threads append to a bounded buffer; one thread of our own encodes, hashes, compresses
and writes. What does not fit is counted and named in the file; a disk that is full ends the
recording, not the flight; a process that is killed leaves all but the last second.
"""

from __future__ import annotations

import contextlib
import json
import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

from pipeline.errors import DataError
from pipeline.measuring.profiler import Profiler
from pipeline.message import Message
from pipeline.recording.channels import Channels
from pipeline.recording.codec import Codecs, Schema
from pipeline.recording.digest import digest_of, size_of
from pipeline.recording.manifest import Manifest
from pipeline.recording.mcap import Compression, McapWriter
from pipeline.recording.tap import Row, TappedScheduler
from pipeline.scheduling.events import Observer
from pipeline.scheduling.topology import Port, Topology

#: The topic of the decisions: a JSON text per tenth of a second.
DECISIONS = "overflight/decisions"
#: What the buffer holds: 0.7 s of everything that the paper's graph makes, 2.5 s of its sensors.
BUFFER_BYTES = 256 << 20
#: Rows and messages in the buffer: minutes of them, should the disk stand still.
BUFFER_ITEMS = 200_000
#: The writer looks this often: were it woken by each message, the threads of the flight would wait.
POLL_S = 0.1
#: What a killed process may cost.
FLUSH_S = 1.0
#: Rows in one JSON text, where the writer is behind.
ROWS = 1_000

_SCHEMA = Schema(
    "overflight.Decisions",
    "jsonschema",
    json.dumps(
        {
            "title": "overflight.Decisions",
            "type": "object",
            "properties": {
                "process": {"type": "string"},
                "rows": {"type": "array", "description": "number, event, now, arguments, followed"},
                "hashes": {"type": "array", "description": "stage, port, number, XXH3"},
                "lost": {"type": "array", "description": "stage, port, number, stamp, why"},
            },
        }
    ).encode(),
    "json",
)
_log = logging.getLogger(__name__)


class _Kept(NamedTuple):
    """A message in the buffer."""

    port: Port
    message: Message[Any]
    size: int


class Recorder:
    """Records one process of one run; a context manager around it, whose end writes the index.

    `stored` are the ports whose messages are written, all others are hashed. Half of the buffer is
    kept for `sources`: without one of their messages there is no exact replay.
    """

    def __init__(
        self,
        path: Path,
        manifest: Manifest,
        codecs: Codecs,
        *,
        stored: Collection[Port],
        sources: Collection[Port],
        compression: Compression = "lz4",
        buffer_bytes: int = BUFFER_BYTES,
    ) -> None:
        self.path = path
        self._manifest = manifest
        self._stored = frozenset(stored)
        self._sources = frozenset(sources)
        self._buffer_bytes = buffer_bytes
        self.file = McapWriter(path, compression)  #: the caller may write to it before the run
        self._channels = Channels(self.file, codecs)
        self._inbox: deque[Row | _Kept] = deque()
        self._hashed: deque[_Kept] = deque()  #: what is hashed only goes first: it frees room soon
        self._came = 0  #: bytes; the driver's
        self._gone = 0  #: bytes; the writer's
        self._peak = 0
        self._rows_lost = 0
        self._overrun: Counter[Port] = Counter()  #: messages that found the buffer full
        self._unwritten: Counter[Port] = Counter()  #: messages that no codec could write
        self._written: Counter[Port] = Counter()
        self._ended: str | None = None  #: why the recording ended before the flight
        self._rows: list[Row] = []
        self._hashes: list[Row] = []
        self._lost: list[Row] = []
        self._last = 0  #: the time of the last row
        self._cpu_s = 0.0  #: of the writer's thread
        self._stop = threading.Event()

    def __enter__(self) -> Self:
        self.file.__enter__()
        try:
            self.file.note(*self._manifest.note())
            self.file.add_channel(DECISIONS, _SCHEMA)
            self.file.flush()
        except DataError:
            self.file.leave()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._ended is not None:
            self.file.leave()
            return
        try:
            self._drain()
            self.file.note("recording", {"statistics": json.dumps(self.statistics())})
            self.file.__exit__(kind, error, trace)
        except DataError as failure:
            self._end(failure)
            self.file.leave()

    # ------------------------------------------------------------------ under the driver's lock

    def scheduler(
        self, topology: Topology, *, offline: bool = False, observer: Observer | None = None
    ) -> TappedScheduler:
        """A scheduler that is recorded."""
        return TappedScheduler(topology, self, offline=offline, observer=observer)

    def row(self, row: Row) -> None:
        """Keep an event with all that followed."""
        if len(self._inbox) >= BUFFER_ITEMS:
            self._rows_lost += 1  # the numbers of the rows show the gap
        elif self._ended is None:
            self._inbox.append(row)

    def message(self, port: Port, message: Message[Any]) -> bool:
        """Keep a message; False where there is no room."""
        if self._ended is not None:
            return True
        size = size_of(message.payload)
        held = self._came - self._gone + size
        if held > (self._buffer_bytes if port in self._sources else self._buffer_bytes // 2):
            self._overrun[port] += 1
            return False
        self._came += size
        self._peak = max(self._peak, held)
        inbox = self._inbox if port in self._stored else self._hashed
        inbox.append(_Kept(port, message, size))
        return True

    # ------------------------------------------------------------------ the writer

    @contextlib.contextmanager
    def writing(self, profiler: Profiler) -> Iterator[None]:
        """Write what is kept, on a thread of our own, until the end of the block."""
        thread = threading.Thread(target=self._write, args=(profiler,), daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._stop.set()
            thread.join()

    def write_now(self) -> None:
        """Give everything that is kept to the system: a crash cannot take it any more."""
        try:
            self._drain()
            self.file.flush()
        except DataError as error:
            self._end(error)

    def _write(self, profiler: Profiler) -> None:
        with profiler.thread("recorder"):
            try:
                flush_at = time.monotonic() + FLUSH_S
                while self._ended is None and not self._stop.wait(POLL_S):
                    if time.monotonic() >= flush_at:
                        self.write_now()
                        flush_at = time.monotonic() + FLUSH_S
                    else:
                        self._drain()
            except DataError as error:
                self._end(error)
            finally:
                self._cpu_s = time.thread_time()

    def _drain(self) -> None:
        """Write what is in the buffer now."""
        for _ in range(len(self._inbox)):
            self._hash()
            item = self._inbox.popleft()
            if not isinstance(item, _Kept):
                self._rows.append(item)
                self._last = item[2]
                if len(self._rows) >= ROWS:
                    self._write_rows()
            elif self._ended is None:
                self._write_message(item)
                self._gone += item.size
        self._write_rows()

    def _hash(self) -> None:
        """Hash what is not written; before the rows that tell of it."""
        while self._hashed:
            kept = self._hashed.popleft()
            self._digest(kept)
            self._gone += kept.size

    def _digest(self, kept: _Kept) -> str | None:
        digest = digest_of(kept.message.payload)
        if digest is not None:
            self._hashes.append((*kept.port, kept.message.seq, digest))
        return digest

    def _write_message(self, kept: _Kept) -> None:
        port, message = kept.port, kept.message
        digest = self._digest(kept)
        try:
            self._channels.write(port, message, digest)
        except DataError as error:
            if self.file.broken:
                raise
            self._lost.append((*port, message.seq, message.stamp, str(error)))
            if not self._unwritten[port]:
                _log.warning("%s: not recorded: %s", port, error)
            self._unwritten[port] += 1
        else:
            self._written[port] += 1

    def _write_rows(self) -> None:
        self._hash()
        if self._ended is not None or not (self._rows or self._hashes or self._lost):
            return
        page = {
            "process": self._manifest.process,
            "rows": self._rows,
            "hashes": self._hashes,
            "lost": self._lost,
        }
        text = json.dumps(page, separators=(",", ":"), default=int)  # default: numpy's integers
        self._rows, self._hashes, self._lost = [], [], []
        self.file.write(DECISIONS, text.encode(), received=self._last, stamp=self._last)

    def _end(self, error: DataError) -> None:
        self._ended = str(error)
        self._inbox.clear()
        self._hashed.clear()
        _log.warning("the recording ends here, the flight goes on: %s", error)

    # ------------------------------------------------------------------ after it

    def statistics(self) -> dict[str, Any]:
        """What was recorded, and what was not."""
        return {
            "path": str(self.path),
            "messages": {str(port): count for port, count in self._written.items()},
            "lost_buffer_full": {str(port): count for port, count in self._overrun.items()},
            "lost_no_codec": {str(port): count for port, count in self._unwritten.items()},
            "decisions_lost": self._rows_lost,
            "cpu_s": round(self._cpu_s, 3),
            "buffer_peak_mb": round(self._peak / 1e6, 1),
            "ended_early": self._ended,
        }
