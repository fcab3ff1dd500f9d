"""Work that is done several pieces at a time, each in a process of its own.

For pieces that keep one core busy for minutes and leave what they made in files.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from io import TextIOBase
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import IO, Any, cast

from rich.console import Console

from pipeline.errors import DataError, OverflightError
from pipeline.transport.child_end import end_with

#: What a piece is called with: a console whose lines begin with the piece's name.
Work = Callable[[Console], None]


def at_once(pieces: Mapping[str, Work], jobs: int) -> Iterator[str]:
    """Do all of it, at most `jobs` at a time, each in a fresh process that ends with this one; the
    names as they are done. A `Work` is pickled: a function of a module, or a partial of one.

    The first that raises OverflightError stops the others, and is raised as DataError. Ctrl-C is
    handed on once, so that what trains can save, and raised when all have ended.
    """
    waiting = list(pieces.items())
    running: dict[str, tuple[BaseProcess, Connection]] = {}
    with _ended(running):
        while waiting or running:
            while waiting and len(running) < jobs:
                name, work = waiting.pop(0)
                running[name] = _started(name, work)
            ready = wait([process.sentinel for process, _ in running.values()])
            over = [name for name, (process, _) in running.items() if process.sentinel in ready]
            for name in over:
                process, failures = running.pop(name)
                process.join()
                with contextlib.suppress(EOFError):  # it has nothing to say
                    raise DataError(f"{name}: {failures.recv()}")
                if process.exitcode:
                    raise DataError(f"{name}: its process ended with {process.exitcode}")
                yield name


def _started(name: str, work: Work) -> tuple[BaseProcess, Connection]:
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(
        target=_do, args=(name, work, os.getpid(), sender), name=name, daemon=True
    )
    process.start()
    sender.close()
    return process, receiver


@contextlib.contextmanager
def _ended(running: Mapping[str, tuple[BaseProcess, Any]]) -> Iterator[None]:
    """However the block ends, ask what still runs to end as by Ctrl-C, and wait for it."""
    try:
        yield
    finally:
        for process, _ in running.values():
            if process.pid is not None and process.is_alive():
                os.kill(process.pid, signal.SIGINT)
        for process, _ in running.values():
            process.join()


def _do(name: str, work: Work, parent: int, failures: Connection) -> None:
    """What a process does; a sentence goes to its parent where it fails."""
    os.setpgid(0, 0)  # Ctrl-C is the parent's to hand on
    if not end_with(parent):
        return
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        stream = cast(IO[str], _Named(sys.stderr, name))
        work(Console(file=stream, highlight=False, soft_wrap=True))
    except OverflightError as error:
        failures.send(str(error))
    except KeyboardInterrupt:
        sys.exit(1)


class _Named(TextIOBase):
    """A stream whose lines begin with a name: several processes write to one terminal."""

    def __init__(self, stream: Any, name: str) -> None:
        self._stream = stream
        self._name = name
        self._line = ""

    def write(self, text: str) -> int:
        *whole, self._line = (self._line + text).split("\n")
        for line in whole:
            self._stream.write(f"{self._name}: {line}\n")
        self._stream.flush()
        return len(text)
