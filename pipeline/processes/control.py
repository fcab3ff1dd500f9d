"""The part's end of its supervisor's calls: answered by a thread of its own, while the part opens
and runs.

A call is a header; the answer carries the part's state, and a page of JSON where one is asked for.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any

import numpy as np

from pipeline.errors import OverflightError
from pipeline.processes.joint import Go, Stoppable
from pipeline.transport.mailbox import Arrays, Closed, Mailbox


class State(StrEnum):
    """How far a part is."""

    OPENING = "opening"
    READY = "ready"  #: waits for the word to go
    RUNNING = "running"
    ENDED = "ended"  #: its report is there
    FAILED = "failed"  #: it did not open, or broke; `text` says why


class Stopped(OverflightError):
    """The supervisor ended the part before it began."""


class Control:
    """Answers calls until the supervisor is gone. `pages` is where the run puts up its status."""

    def __init__(self, mailbox: Mailbox) -> None:
        self._mailbox = mailbox
        self._state = State.OPENING
        self._first: int | None = None
        self._text = ""
        self._page: dict[str, Any] = {}
        self._report: dict[str, Any] = {}
        self._go: Go | None = None
        self._changed = threading.Condition()
        self._stopped = False
        self._taken = threading.Event()  #: the report was asked for
        self._driver: Stoppable | None = None
        self._missing: Callable[[], list[str]] = list
        self._clock: Callable[[], tuple[int, int] | None] = lambda: None
        self.gone: Callable[[str], None] = lambda process: None  #: a process will not come back

    # ------------------------------------------------------------------ the part's side

    def write(self, page: Mapping[str, Any]) -> None:
        """Put up how the run stands (as on a `Board`)."""
        self._page = dict(page)

    def ready(
        self,
        first: int | None,
        missing: Callable[[], list[str]],
        clock: Callable[[], tuple[int, int] | None] = lambda: None,
    ) -> Go:
        """Say that the part is open, and wait for the word. Raises Stopped.

        `missing` says whom it has not heard of, `clock` what it knows of another host's clock.
        """
        with self._changed:
            self._first, self._state = first, State.READY
            self._missing, self._clock = missing, clock
            self._changed.wait_for(lambda: self._go is not None or self._stopped)
            if self._go is None:
                raise Stopped("stopped before it began")
            self._state = State.RUNNING
            return self._go

    def running(self, driver: Stoppable) -> None:
        """The driver is there: it can be stopped."""
        with self._changed:
            self._driver = driver
            if self._stopped:
                driver.stop()

    def ended(self, report: Mapping[str, Any], wait_s: float) -> None:
        """Hold the report until it is asked for, at most so long."""
        self._report, self._state = dict(report), State.ENDED
        self._taken.wait(wait_s)

    def failed(self, text: str, wait_s: float) -> None:
        """Hold the reason until it is asked for, at most so long."""
        self._text, self._state = text, State.FAILED
        self._taken.wait(wait_s)

    # ------------------------------------------------------------------ the supervisor's side

    def serve(self) -> None:
        """Answer until the supervisor is gone; then the part ends."""
        try:
            while True:
                header, _ = self._mailbox.receive()
                answer, arrays = self._answer(header)
                self._mailbox.send(answer, arrays)
                told = (State(answer["state"]), header.get("call"))
                if told in ((State.ENDED, "report"), (State.FAILED, "state")):
                    self._taken.set()
        except Closed:
            self._stop()

    def _answer(self, header: Mapping[str, Any]) -> tuple[Mapping[str, Any], Arrays]:
        call = header.get("call")
        answer: dict[str, Any] = {"state": str(self._state)}
        if call == "go":
            with self._changed:
                self._go = Go(header["origin"], header["began_ns"], header["late"])
                self._changed.notify_all()
        elif call == "stop":
            self._stop()
        elif call == "gone":
            self.gone(header["process"])
        elif call == "state":
            answer |= {"first": self._first, "text": self._text, "cpu_s": time.process_time()}
            if self._state is State.READY:
                answer |= {"missing": self._missing(), "clock": self._clock()}
        elif call == "page":
            return answer, as_bytes(self._page)
        elif call == "report":
            return answer, as_bytes(self._report)
        return answer, {}

    def _stop(self) -> None:
        with self._changed:
            self._stopped = True
            if self._driver is not None:
                self._driver.stop()
            self._changed.notify_all()


def as_bytes(page: Mapping[str, Any]) -> Arrays:
    """A page of any size, to send as an array."""
    return {"json": np.frombuffer(json.dumps(page).encode(), np.uint8)}


def from_bytes(arrays: Arrays) -> dict[str, Any]:
    """The page that was sent."""
    page: dict[str, Any] = json.loads(bytes(arrays["json"]))
    return page
