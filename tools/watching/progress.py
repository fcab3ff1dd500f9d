"""What a run says of itself while it goes on: one live line on a terminal, else plain lines."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

if TYPE_CHECKING:
    from pipeline.drivers.snapshot import Snapshot
    from pipeline.scheduling.topology import Topology

#: Between two plain lines: a log of an hour's flight stays readable.
PLAIN_PERIOD_S = 5.0

#: What is left is told from this share of a run on: before it the first messages weigh too much.
FORESEEN_FROM = 0.03

#: Until the first message; loading models and compiling kernels is what takes the time.
OPENING = "opening devices, models and stages (the first run compiles kernels, up to a minute) ..."


def end_ports(topology: Topology) -> tuple[str, ...]:
    """The output ports at the end of the graph: read by nobody, or by sinks alone.

    They are what a person waits for; all others are in the table at the end of the run.
    """
    read_on: dict[str, bool] = {
        f"{stage.name}/{port}": False for stage in topology.stages for port in stage.outputs
    }
    for stage in topology.stages:
        for source in (source for entry in stage.inputs for source in entry.sources):
            read_on[str(source)] |= bool(stage.outputs)
    return tuple(port for port, further in read_on.items() if not further)


def progress_line(snapshot: Snapshot, ends: tuple[str, ...]) -> str:
    """``12.3 s   41 %, 18 s left   semantic_map 9.9 Hz, 142 ms old   31 dropped``"""
    parts = [f"{snapshot.elapsed_s:6.1f} s", *_how_far(snapshot)]
    for port in ends:
        output = snapshot.outputs[port]
        part = f"{port.removesuffix('/out')} "
        count = f"{output.count} message{'s' * (output.count != 1)}"
        part += count if output.rate_hz is None else f"{output.rate_hz:.1f} Hz"
        if output.age_ms is not None:
            part += f", {output.age_ms:.0f} ms old"
        parts.append(part)
    parts.append(f"{snapshot.dropped} dropped")
    return "   ".join(parts)


def _how_far(snapshot: Snapshot) -> list[str]:
    """Where the end is known: the share that is behind, and, after its first part, what is left."""
    if snapshot.done is None:
        return []
    told = f"{snapshot.done:.0%}".replace("%", " %")
    if snapshot.done < FORESEEN_FROM:
        return [told]
    left_s = snapshot.elapsed_s * (1 / snapshot.done - 1)
    left = f"{left_s:.0f} s" if left_s < 100 else f"{left_s / 60:.0f} min"
    return [f"{told}, {left} left"]


class Progress:
    """Shows the snapshots of a run; the driver calls it, from one thread, a few times a second."""

    def __init__(self, topology: Topology, console: Console) -> None:
        self._ends = end_ports(topology)
        self._console = console
        self._live = Live(Text(OPENING), console=console, auto_refresh=False, transient=True)
        self._next_plain_s = PLAIN_PERIOD_S
        self._events_shown = 0

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live.start(refresh=True)
        else:
            self._say(OPENING)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._live.stop()

    def __call__(self, snapshot: Snapshot) -> None:
        for event in snapshot.events[self._events_shown :]:
            first_line = event.text.partition("\n")[0]
            self._say(f"{snapshot.elapsed_s:6.1f} s   {event.kind} {event.subject}: {first_line}")
        self._events_shown = len(snapshot.events)
        if self._live.is_started:
            line = Text(progress_line(snapshot, self._ends), no_wrap=True, overflow="ellipsis")
            self._live.update(line, refresh=True)
        elif snapshot.elapsed_s >= self._next_plain_s:
            self._next_plain_s = snapshot.elapsed_s + PLAIN_PERIOD_S
            self._say(progress_line(snapshot, self._ends))

    def _say(self, line: str) -> None:
        """A line that stays, above the live one."""
        self._console.print(Text(line), soft_wrap=True)
