"""What a soak sees of a run: its status page and its processes, look by look."""

from __future__ import annotations

import os
import signal
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import psutil

from pipeline.transport.shared_files import FOLDER, PREFIX

#: Memory and descriptors of a life are read at this age: what it opens and warms up is there.
SETTLED_S = 10.0
#: The supervisor is read as often as that, and so is /dev/shm.
READING_S = 5.0


@dataclass(slots=True)
class Life:
    """One life of a process: what it held at `SETTLED_S`, and what it held last."""

    name: str
    born_s: float  #: of the soak
    settled_mb: float | None = None
    last_mb: float = 0.0
    settled_descriptors: int | None = None
    last_descriptors: int = 0
    last_s: float = 0.0


@dataclass(slots=True)
class Kill:
    """A SIGKILL, and when the outputs of the killed process came again, as the page showed it."""

    name: str
    at_s: float
    counts: dict[str, int]  #: by output of that process, when its next life was first seen
    pid: int  #: that was killed
    back_s: dict[str, float] = field(default_factory=dict)  #: by output, from the kill
    seen: bool = False  #: the page has shown its next life

    @property
    def first_s(self) -> float | None:
        return min(self.back_s.values(), default=None)

    @property
    def all_s(self) -> float | None:
        """When the last of them was back; None while one is silent."""
        return (
            max(self.back_s.values(), default=0.0)
            if self.back_s.keys() == self.counts.keys()
            else None
        )


@dataclass(frozen=True, slots=True)
class Reading:
    """The supervisor and the shared memory of a run at one time."""

    at_s: float
    supervisor_mb: float
    supervisor_descriptors: int
    files: int
    shared_mb: float


class Watch:
    """Collects the looks at one run, whose supervisor has the given process id.

    `owners` are the processes that make each output.
    """

    def __init__(self, supervisor: int, owners: Mapping[str, str]) -> None:
        self._supervisor = psutil.Process(supervisor)
        self._began: float | None = None
        self._now = 0.0
        self._counts: dict[str, int] = {}
        self._changed: dict[str, float] = {}
        self._owners = owners
        self._next_reading = 0.0
        self.pids: dict[str, int] = {}
        self.gaps_s: dict[str, float] = {}  #: the longest silence of each output
        self.lives: dict[int, Life] = {}  #: by pid
        self.kills: list[Kill] = []
        self.readings: list[Reading] = []
        self.left_files: list[str] = []

    # ------------------------------------------------------------------ looks

    @property
    def flows(self) -> bool:
        """Every output has said something."""
        return bool(self._counts) and all(self._counts.values())

    @property
    def all_back(self) -> bool:
        """Every output of every killed process has come again."""
        return all(kill.all_s is not None for kill in self.kills)

    @property
    def seconds(self) -> float:
        """How long the run was watched since all outputs flowed."""
        return 0.0 if self._began is None else self._now - self._began

    def began(self, now: float) -> None:
        """All flows: from here on silences count."""
        self._began = self._now = now
        self._changed = dict.fromkeys(self._counts, now)
        self.gaps_s = dict.fromkeys(self._counts, 0.0)

    def look(self, page: Mapping[str, Any], now: float) -> None:
        """Take in a status page and the processes that it names."""
        self._now = now
        self.pids = {
            name: found["pid"] for name, found in page["processes"].items() if found["pid"]
        }
        for name, output in page["outputs"].items():
            self._output(name, int(output["count"]), now)
        for kill in self.kills:
            kill.seen |= self.pids.get(kill.name, kill.pid) != kill.pid
        if self._began is None:
            return
        for name, pid in self.pids.items():
            self._process(name, pid)
        if self.seconds >= self._next_reading:
            self._next_reading = self.seconds + READING_S
            self._read()

    def kill(self, name: str, now: float) -> None:
        """SIGKILL to a process of the run."""
        assert self._began is not None
        mine = {
            output: count for output, count in self._counts.items() if self._owners[output] == name
        }
        os.kill(self.pids[name], signal.SIGKILL)
        self.kills.append(Kill(name, now - self._began, mine, self.pids[name]))

    def ended(self) -> None:
        """The run is over: what of its shared memory is left is a leak."""
        self.left_files = [path.name for path in self._files()]

    def sentence(self) -> str:
        """How it stands, for the progress bar."""
        longest = max(self.gaps_s.values(), default=0.0)
        return f"{len(self.kills)} kills, longest silence {longest:.1f} s"

    def page(self) -> dict[str, Any]:
        """Everything, as JSON values."""
        return {
            "seconds": round(self.seconds, 1),
            "kills": [asdict(kill) for kill in self.kills],
            "gaps_s": self.gaps_s,
            "lives": [asdict(life) for life in self.lives.values()],
            "readings": [asdict(reading) for reading in self.readings],
            "left_files": self.left_files,
        }

    # ------------------------------------------------------------------ parts of a look

    def _output(self, name: str, count: int, now: float) -> None:
        before = self._counts.get(name, 0)
        self._counts[name] = max(count, before)
        if self._began is None:
            return
        silent = now - self._changed[name]
        self.gaps_s[name] = max(self.gaps_s[name], silent)
        if count > before:
            self._changed[name] = now
        for kill in self.kills:
            if name not in kill.counts or name in kill.back_s:
                continue
            if not kill.seen:  # the page was older than the kill: it had made more by then
                kill.counts[name] = max(count, kill.counts[name])
            elif count > kill.counts[name]:
                kill.back_s[name] = self.seconds - kill.at_s

    def _process(self, name: str, pid: int) -> None:
        life = self.lives.setdefault(pid, Life(name, self.seconds))
        if self.seconds - life.last_s < 1.0:
            return
        try:
            process = psutil.Process(pid)
            memory = process.memory_info()
            if not memory.rss:  # killed, and not yet waited for
                return
            life.last_mb = round((memory.rss - memory.shared) / 1e6, 1)
            life.last_descriptors = process.num_fds()
        except psutil.Error:  # killed since
            return
        life.last_s = self.seconds
        if life.settled_mb is None and self.seconds - life.born_s >= SETTLED_S:
            life.settled_mb, life.settled_descriptors = life.last_mb, life.last_descriptors

    def _read(self) -> None:
        memory = self._supervisor.memory_info()
        sizes = []
        for path in self._files():
            try:
                sizes.append(path.stat().st_size)
            except FileNotFoundError:
                continue
        self.readings.append(
            Reading(
                self.seconds,
                round((memory.rss - memory.shared) / 1e6, 2),
                self._supervisor.num_fds(),
                len(sizes),
                round(sum(sizes) / 1e6, 2),
            )
        )

    def _files(self) -> list[Path]:
        """The shared memory of this run alone: it is named after the graph and its supervisor."""
        return sorted(FOLDER.glob(f"{PREFIX}*-{self._supervisor.pid}-*"))
