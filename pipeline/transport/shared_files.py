"""The shared-memory files of one host: named after their run, locked while their owner lives.

A process that is killed cannot remove its files, but the kernel releases its lock: `sweep` removes
every file of ours that nobody has locked. It runs at the start of a run, and after a process died.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import stat
from pathlib import Path

from pipeline.errors import TransportError

FOLDER = Path("/dev/shm")
PREFIX = "overflight-"
_NAME = re.compile(PREFIX + r"[A-Za-z0-9_.-]{1,200}")


def create(run: str, size: int, folder: Path = FOLDER) -> tuple[str, int]:
    """A new file that only its user reads, locked by the descriptor that is returned with its name.

    Raises TransportError where there is no room.
    """
    while True:
        name = f"{PREFIX}{run}-{os.getpid()}-{os.urandom(4).hex()}"
        if not _NAME.fullmatch(name):
            raise TransportError(f"'{run}' is no name of a run; use letters, digits, - _ and .")
        path = folder / name
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        except FileExistsError:
            continue
        except OSError as error:
            raise _no_room(size, folder, error) from None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            if not os.fstat(descriptor).st_nlink:  # a sweep came between its birth and its lock
                os.close(descriptor)
                continue
            # Allocated, not only as long: a full /dev/shm is an error here, not a signal later.
            os.posix_fallocate(descriptor, 0, size)
        except OSError as error:
            path.unlink(missing_ok=True)
            os.close(descriptor)
            raise _no_room(size, folder, error) from None
        return name, descriptor


def open_to_read(name: str, folder: Path = FOLDER) -> int:
    """The descriptor of another process's file. Raises OSError or ValueError for what is none."""
    if not _NAME.fullmatch(name):
        raise ValueError(f"'{name[:80]}' is no name of shared memory of ours")
    flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    descriptor = os.open(folder / name, flags)
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode) or status.st_uid != os.geteuid():
        os.close(descriptor)
        raise ValueError(f"{name} belongs to another user")
    return descriptor


def sweep(run: str = "", folder: Path = FOLDER) -> list[str]:
    """Remove our user's files whose owner is gone, of one run or of all; returns their names."""
    removed = []
    for path in sorted(folder.glob(f"{PREFIX}{f'{run}-' if run else ''}*")):
        try:
            descriptor = open_to_read(path.name, folder)
        except (OSError, ValueError):
            continue
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink(missing_ok=True)
            removed.append(path.name)
        os.close(descriptor)
    return removed


def _no_room(size: int, folder: Path, error: OSError) -> TransportError:
    return TransportError(
        f"no {size / 1e6:.1f} MB of shared memory in {folder} ({error.strerror}); free some, or "
        "lower slots or max_bytes of the edge"
    )
