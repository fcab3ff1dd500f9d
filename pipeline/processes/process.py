"""One process of a graph as its supervisor sees it: started, asked, lost, started anew.

Nothing here waits: a call is sent when the last one was answered, and an answer is read when it is
there. One that is long overdue is the end of the process, which hangs.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from pipeline.errors import DeviceError
from pipeline.graph.placing import GraphProcess
from pipeline.processes.control import State, from_bytes
from pipeline.transport.child import Child
from pipeline.transport.mailbox import Closed

#: How long a call may go without an answer. Compiling kernels can hold Python's lock for seconds.
SILENCE_S = 30.0
#: More than this between two polls is not counted.
MOST_BETWEEN_S = 1.0


class PartProcess:
    """The process, what it said last, and what is left of its earlier lives."""

    def __init__(self, process: GraphProcess, module: str, opening: Mapping[str, Any]) -> None:
        self.name = process.name
        self.state: State | None = None  #: None: not running
        self.first: int | None = None  #: when its first sample arrives
        self.missing: list[str] = []  #: ports that it has not heard of
        self.clock: tuple[int, int] | None = None  #: another host's clock, as it heard it
        self.text = ""  #: why it failed
        self.cpu_s = 0.0  #: what it has computed in this life
        self.lost_at = 0.0  #: when its last life ended
        self.report: dict[str, Any] | None = None
        self.ended_at: float | None = None  #: when it left that, until the others are told
        self.page: dict[str, Any] = {}  #: how its run stands
        self.lives = 0  #: started so often
        self.joined = 0  #: the life that was given the word to go
        self.past: list[dict[str, Any]] = []  #: the last page of each earlier life
        self.given_up = False
        self._child = Child(process.name, module, process.restarts, timeout_s=SILENCE_S)
        self._opening = opening
        self._calls: deque[Mapping[str, Any]] = deque()
        self._asked: str | None = None  #: the call under way
        self._silent_s = 0.0  #: since then
        self._polled = 0.0

    @property
    def pid(self) -> int | None:
        return self._child.pid

    @property
    def over(self) -> bool:
        """It will do nothing more."""
        return self.given_up or self.report is not None

    def start(self) -> None:
        """Start it (anew). Raises DeviceError where the rules do not allow it."""
        self._child.mailbox()
        self.lives += 1
        self.state = State.OPENING
        self.page, self.first, self.missing = {}, None, []
        self._calls.clear()
        self._asked = None
        self.call({**self._opening, "life": self.lives})

    def call(self, header: Mapping[str, Any]) -> None:
        """Say something as soon as the last call is answered."""
        self._calls.append(header)

    def poll(self, now: float) -> str | None:
        """Read what is there and send what is due; how the process ended, if it did."""
        # Where we were stopped ourselves, or the machine slept, that was not its silence.
        self._silent_s += min(now - self._polled, MOST_BETWEEN_S)
        self._polled = now
        if self.state is None:
            return None
        try:
            alive, mailbox = self._child.alive, self._child.last_mailbox
            if mailbox is not None and self._asked is not None and mailbox.readable():
                self._heard(*mailbox.receive())
            if alive and mailbox is not None and self._asked is None and self._calls:
                header = self._calls.popleft()
                self._asked, self._silent_s = str(header["call"]), 0.0
                mailbox.send(header)
        except Closed:
            how = self._child.how_it_ended()
            self._child.kill()  # where it only closed its end: it could not be started anew
            return self._lost(how)
        if not self._child.alive:
            return self._lost(self._child.how_it_ended())
        if self._asked is not None and self._silent_s > SILENCE_S:
            self._child.kill()
            return self._lost(f"did not answer for {SILENCE_S:g} s and was killed")
        return None

    def ask(self, call: str) -> None:
        """Ask for something once: not while an earlier one of its kind waits."""
        if not any(waiting["call"] == call for waiting in self._calls):
            self.call({"call": call})

    def restart(self) -> str | None:
        """Start it anew, or give it up and say why."""
        try:
            self.start()
        except DeviceError as error:
            self.given_up = True
            return str(error)
        return None

    def kill(self) -> None:
        """SIGKILL, as anybody could send it; `poll` finds out."""
        if self._child.alive:
            self._child.kill()

    def close(self) -> None:
        """End the process, however it is."""
        self._child.close()
        self._child.kill()
        self.state = None

    def _heard(self, answer: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
        assert self._asked is not None
        call, self._asked = self._asked, None
        self.state = State(answer["state"])
        if call == "state":
            self.first, self.text = answer.get("first"), answer.get("text", "")
            self.cpu_s = answer.get("cpu_s", 0.0)
            self.missing = answer.get("missing", [])
            self.clock = answer.get("clock")
        elif call == "page":
            self.page = from_bytes(arrays) or self.page
        elif call == "report":
            self.report = from_bytes(arrays)
            self.ended_at = time.monotonic()

    def _lost(self, how: str) -> str | None:
        self.state = None
        if self.report is not None:
            return None
        self.past.append(self.page)
        self.lost_at = time.monotonic()
        return how
