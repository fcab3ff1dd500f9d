"""Two network namespaces with a cable between them: two hosts, as far as the network can tell."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Sequence

ENDPOINT = "tcp/10.213.7.1:7447"  #: on the first host


class NotAllowed(Exception):
    """This machine does not let us make them; the text says what failed."""


class Namespaces:
    """A context manager; `commands` are what to write before a command to run it on a host."""

    def __init__(self) -> None:
        self.names = tuple(f"overflight-{os.getpid()}-{host}" for host in "ab")
        self.commands: Sequence[Sequence[str]] = tuple(
            ("ip", "netns", "exec", name) for name in self.names
        )

    def __enter__(self) -> Namespaces:
        try:
            for name in self.names:
                _ip("netns", "add", name)
            # Each end is made where it belongs: no name of the machine's own is in the way.
            _ip("-n", self.names[0], "link", "add", "cable", "type", "veth", "peer", "cable",
                "netns", self.names[1])  # fmt: skip
            for number, name in enumerate(self.names):
                _ip("-n", name, "addr", "add", f"10.213.7.{number + 1}/24", "dev", "cable")
                self.plug(name, "up")
                _ip("-n", name, "link", "set", "lo", "up")
            _run(*self.commands[0], "true")
        except NotAllowed:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        for name in self.names:  # what was in it goes with it
            subprocess.run(("ip", "netns", "delete", name), capture_output=True, check=False)

    def plug(self, name: str, state: str) -> None:
        """Pull one end of the cable (``down``), or plug it in (``up``)."""
        _ip("-n", name, "link", "set", "cable", state)

    def slow(self, rate: str) -> None:
        """Let no more than `rate` (``2mbit``) leave the first host."""
        queue = ("root", "tbf", "rate", rate, "burst", "32kbit", "latency", "100ms")
        _run(*self.commands[0], "tc", "qdisc", "add", "dev", "cable", *queue)


def _ip(*words: str) -> None:
    _run("ip", *words)


def _run(*command: str) -> None:
    try:
        subprocess.run(command, capture_output=True, text=True, check=True)
    except FileNotFoundError:
        raise NotAllowed(f"there is no program '{command[0]}' here") from None
    except subprocess.CalledProcessError as error:
        raise NotAllowed(f"`{' '.join(command)}` failed: {error.stderr.strip()}") from None
