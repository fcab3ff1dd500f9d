"""`--trace` of a run: what its processes record, and the one file that is made of it."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from pipeline.graph.graph import Graph
from pipeline.measuring.trace import Trace, saved_name
from pipeline.scheduling.topology import Topology
from tools.watching.trace import write_trace
from tools.watching.trace_drawing import Traced

#: What the supervisor's own events stand under.
SUPERVISOR = "overflight run"


class Tracing:
    """A context manager around a run that writes its trace, however it ends: a run that ended badly
    is the one to look at.

    `apart`: the graph runs in several processes, each of which saves its entries beside the file.
    Of a life that was killed nothing is left.
    """

    def __init__(
        self, path: Path, capacity: int, graph: Graph, *, apart: bool, quiet: bool
    ) -> None:
        self.path = path
        self.own = Trace(capacity)  #: of this process
        self.recorded = self.overwritten = 0  #: once it is written
        self.failure: str | None = None  #: why it could not be written
        self._capacity = capacity
        self._graph = graph
        self._apart = apart
        self._quiet = quiet

    def __enter__(self) -> Tracing:
        if self._apart:
            self._folder = tempfile.TemporaryDirectory(prefix=".trace-", dir=self.path.parent)
        return self

    def __exit__(self, *error: object) -> None:
        traced = self._traced()
        if self._apart:
            self._folder.cleanup()
        self.recorded = sum(each.trace.recorded for each in traced)
        self.overwritten = sum(each.trace.overwritten for each in traced)
        if not self.recorded:
            return
        if not self._quiet:
            typer.echo(f"Writing {self.path} ...", err=True)
        try:
            write_trace(traced, self._graph.name, self.path)
        except OSError as failed:
            self.failure = f"{self.path}: the trace was not written: {failed.strerror}"
            if self.path.is_file():
                self.path.unlink()  # half a trace opens nowhere

    @property
    def asked(self) -> Mapping[str, Any]:
        """What each process is told, as JSON values: at most so many entries, saved there."""
        return {"folder": str(Path(self._folder.name).resolve()), "entries": self._capacity}

    def told(self) -> str:
        """How much of the run is in it."""
        text = f"{self.path} has {self.recorded - self.overwritten} entries"
        if self.overwritten:
            text += f"; {self.overwritten} older ones were overwritten (--trace-entries)"
        return f"{text}. Open it at ui.perfetto.dev."

    def _traced(self) -> list[Traced]:
        if not self._apart:
            return [Traced(self.own, self._graph.topology)]
        found = [Traced(self.own, Topology(()), SUPERVISOR)]
        for name in self._graph.placement.processes():
            lives = Path(self._folder.name).glob(saved_name(name, "*"))
            for file in sorted(lives, key=_life):
                told = name if _life(file) == 1 else f"{name} (start {_life(file)})"
                found.append(Traced(Trace.load(file), self._graph.part(name)[0].topology, told))
        return found


def _life(file: Path) -> int:
    return int(file.suffixes[-2][1:])
