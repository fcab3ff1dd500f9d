"""A file by which a running process says how it stands, and the way to find all that do.

One file per run in a folder that only this user may enter, locked while its writer lives: who finds
it unlocked knows that the writer crashed, and removes it. A page is written over the last one with
its length and checksum in front; a reader that met a half-written page reads again.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import stat
import tempfile
import time
import zlib
from collections.abc import Iterator, Mapping
from itertools import count
from pathlib import Path
from typing import Any

from pipeline.closing import Closing

SUFFIX = ".run"
#: ``checksum length\n``, both of the page that follows.
_HEAD = "{:08x} {:010d}\n"
_HEAD_SIZE = len(_HEAD.format(0, 0))
#: A page takes far less than a millisecond to write.
_TRIES, _PAUSE_S = 20, 0.001
#: Between the making of a file and its lock.
_YOUNG_S = 2.0


def folder() -> Path:
    """Where this user's boards are: under $XDG_RUNTIME_DIR, else in the temporary folder.

    Raises OSError where neither can be had for this user alone.
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    if runtime and os.access(runtime, os.W_OK):
        path = Path(runtime) / "overflight"
    else:
        path = Path(tempfile.gettempdir()) / f"overflight-{os.getuid()}"
    with contextlib.suppress(FileExistsError):
        path.mkdir(mode=0o700)
    found = path.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise PermissionError(f"{path} is not a folder of this user alone; remove it")
    return path


class Board(Closing):
    """The page of one run; a context manager that takes it down. Raises OSError."""

    def __init__(self, place: Path | None = None) -> None:
        place = folder() if place is None else place
        for _ in boards(place):  # removes those of crashed runs
            pass
        for number in count():
            self.path = place / f"{os.getpid()}-{number}{SUFFIX}"
            with contextlib.suppress(FileExistsError):
                flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
                self._file = os.open(self.path, flags, 0o600)
                break
        fcntl.flock(self._file, fcntl.LOCK_EX)

    def write(self, page: Mapping[str, Any]) -> None:
        """Put up a page in place of the last one."""
        text = json.dumps(page, separators=(",", ":")).encode()
        os.pwrite(self._file, _HEAD.format(zlib.crc32(text), len(text)).encode() + text, 0)

    def close(self) -> None:
        """Take it down."""
        self.path.unlink(missing_ok=True)
        os.close(self._file)


def boards(place: Path | None = None) -> Iterator[Path]:
    """The boards of runs that live, by process; those that a crash left are removed.

    Raises OSError where the folder cannot be had for this user alone.
    """
    place = folder() if place is None else place
    for path in sorted(place.glob(f"*{SUFFIX}")):
        if _is_abandoned(path):
            path.unlink(missing_ok=True)
        else:
            yield path


def read_board(path: Path) -> dict[str, Any] | None:
    """The page that is up; None where there is none (any more)."""
    for _ in range(_TRIES):
        try:
            content = path.read_bytes()
        except OSError:
            return None
        with contextlib.suppress(ValueError):
            checksum, length = content[:_HEAD_SIZE].split()
            text = content[_HEAD_SIZE : _HEAD_SIZE + int(length)]
            if zlib.crc32(text) == int(checksum, 16):
                page: dict[str, Any] = json.loads(text)
                return page
        time.sleep(_PAUSE_S)
    return None


def _is_abandoned(path: Path) -> bool:
    """Whether nobody holds its lock. One that is young and empty is just being put up."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            found = os.fstat(file.fileno())
            return found.st_size > 0 or time.time() - found.st_mtime > _YOUNG_S
    except OSError:
        return False
