"""What a person asks of `overflight run`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tools.recording.flight_graph import GraphFiles
from tools.recording.record import RecordOrder


@dataclass(frozen=True, slots=True)
class TraceOrder:
    """A Chrome trace of the run."""

    path: Path
    entries: int  #: at most, the last ones


@dataclass(frozen=True, slots=True)
class RunOrder:
    """One run. With a `flight` its messages take the place of the sources; where that is the path
    of `files`, the graph is the flight's own."""

    files: GraphFiles
    flight: Path | None
    speed: float | None  #: None: offline
    duration_s: float | None
    report: Path | None
    trace: TraceOrder | None
    record: RecordOrder | None
    host: str | None  #: whose part of a graph of several hosts
    as_json: bool
    quiet: bool
