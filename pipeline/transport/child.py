"""A process of our own that may die: started, killed, and started anew by rules.

The rules are never, on-failure or always, and at most so many restarts within a window.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from pipeline.errors import DeviceError
from pipeline.transport.mailbox import Mailbox

#: How long a process may take to end by itself once its end of the socket is closed.
GRACE_S = 1.0
#: How long to wait for the end of a process whose connection is closed, to tell how it ended: one
#: that was killed lets go of its memory after that, which takes a while where the cores are busy.
DEATH_S = 5.0

RestartPolicy = Literal["never", "on-failure", "always"]


@dataclass(frozen=True, slots=True)
class Restarts:
    """When a process that ended is started anew."""

    policy: RestartPolicy = "on-failure"
    most: int = 5  #: restarts within the window
    window_s: float = 60.0


class Child:
    """A Python module run in a process of its own, with a mailbox to it.

    The module's `main` gets the descriptor of its end as its first argument. The process ends with
    ours, however ours ends: its socket closes, and the kernel kills it where it hangs.
    """

    def __init__(
        self, name: str, module: str, restarts: Restarts, *, timeout_s: float | None = None
    ) -> None:
        """`timeout_s`: the longest that it may take to answer; None: for ever."""
        self.name = name
        self._timeout_s = timeout_s
        self._module = module
        self._restarts = restarts
        self._process: subprocess.Popen[bytes] | None = None
        self._mailbox: Mailbox | None = None
        self._started: deque[float] = deque()  #: restarts within the window

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process is not None and self._process.poll() is None

    @property
    def pid(self) -> int | None:
        """Its process id; None while there is none."""
        return None if self._process is None else self._process.pid

    @property
    def last_mailbox(self) -> Mailbox | None:
        """The mailbox to the process as it is, running or ended: its last words may be in it."""
        return self._mailbox

    def mailbox(self) -> Mailbox:
        """The mailbox to the running process, started (anew) if the rules allow.

        Raises DeviceError with the rule where they do not.
        """
        if not self.alive:
            self._start()
        assert self._mailbox is not None
        return self._mailbox

    def how_it_ended(self) -> str:
        """The end of the process, for people."""
        if self._process is None:
            return "was never started"
        try:
            code = self._process.wait(DEATH_S)
        except subprocess.TimeoutExpired:
            return "closed its connection"
        if code < 0:
            return f"was killed by {signal.Signals(-code).name}"
        return f"ended with exit code {code}"

    def kill(self) -> None:
        """End the process at once; whoever waits for its answer gets Closed."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def close(self) -> None:
        """Ask the process to end, and kill it where it does not."""
        if self._mailbox is not None:
            self._mailbox.close()
            self._mailbox = None
        if self._process is not None:
            try:
                self._process.wait(GRACE_S)
            except subprocess.TimeoutExpired:
                self.kill()

    def _start(self) -> None:
        if self._process is not None:
            self._allow(self._process.returncode)
            self.close()
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                self._command(theirs.fileno()), pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL
            )
        self._mailbox = Mailbox(ours, self._timeout_s)

    def _command(self, descriptor: int) -> Sequence[str]:
        return [sys.executable, "-m", self._module, str(descriptor), str(os.getpid()), self.name]

    def _allow(self, code: int | None) -> None:
        """Enter a restart into the books, or raise DeviceError."""
        rules, now = self._restarts, time.monotonic()
        while self._started and now - self._started[0] > rules.window_s:
            self._started.popleft()
        ended = f"its process {self.how_it_ended()}"
        if rules.policy == "never" or (rules.policy == "on-failure" and code == 0):
            raise DeviceError(f"{ended}; restart_policy is {rules.policy}")
        if len(self._started) >= rules.most:
            raise DeviceError(
                f"{ended}, and was restarted {rules.most} times within {rules.window_s:g} s "
                "(max_restarts)"
            )
        self._started.append(now)
