"""Writes a recorded run as Chrome trace events, which ui.perfetto.dev and chrome://tracing open.

Three groups of tracks for each process. Threads: every step where it ran and every sample where it
was brought, with arrows from each message to the runs that used it, also in another process.
Stages: every run with its waits and steps, what was on its way from another process, and the age of
every output. Edges: every loss, with its reason. Times are the machine's, from the first entry on;
stamps, on the graph's clock, are in the arguments.

The format is Google's "Trace Event Format" (2016): phases X (a slice on a thread), b and e (nested
asynchronous slices), s and f (arrows), i (instants), C (counters), M (names of tracks).
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import IO

from tools.watching.trace_drawing import Drawing, Traced, TraceEvent


def write_trace(traced: Sequence[Traced], graph: str, path: Path) -> None:
    """Write the trace as JSON, compressed where the name ends in ``.gz``. Raises OSError.

    All processes are those of one machine, whose clock their entries share.
    """
    about = {
        "graph": graph,
        "entries": sum(each.trace.recorded for each in traced),
        "overwritten": sum(each.trace.overwritten for each in traced),
    }
    with _opened(path) as file:
        file.write(f'{{"displayTimeUnit":"ms","otherData":{json.dumps(about)},"traceEvents":[\n')
        for number, event in enumerate(trace_events(traced)):
            file.write(("" if number == 0 else ",\n") + json.dumps(event, separators=(",", ":")))
        file.write("\n]}\n")


def trace_events(traced: Sequence[Traced]) -> Iterator[TraceEvent]:
    """Every trace event; slices before what they hold and before the arrows between them."""
    serial = count(1)
    drawings = [Drawing(each, 3 * number, serial) for number, each in enumerate(traced)]
    start = min((drawing.start for drawing in drawings if drawing.entries), default=0)
    groups: set[int] = set()
    for drawing in drawings:
        drawing.start = start
        for event in drawing.slices():
            groups.add(event["pid"])
            yield event
    made = {key: at for drawing in drawings for key, at in drawing.made()}
    origins = {key: place for drawing in drawings for key, place in drawing.origins()}
    for drawing in drawings:
        yield from drawing.ways(made)
        yield from drawing.arrows(origins)
        yield from drawing.names(groups)


def _opened(path: Path) -> IO[str]:
    return gzip.open(path, "wt", compresslevel=5) if path.suffix == ".gz" else path.open("w")
