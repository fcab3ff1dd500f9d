"""Writes a recorded run as Chrome trace events, which ui.perfetto.dev and chrome://tracing open.

Three groups of tracks. Threads: every step where it ran and every sample where it was brought, with
arrows from each message to the runs that used it. Stages: every run with its waits and steps, and
the age of every output. Edges: every loss, with its reason. Times are the machine's, from the first
entry on; stamps, on the graph's clock, are in the arguments.

The format is Google's "Trace Event Format" (2016): phases X (a slice on a thread), b and e (nested
asynchronous slices), s and f (arrows), i (instants), C (counters), M (names of tracks).
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator, Mapping
from itertools import count
from pathlib import Path
from typing import IO, Any, TypeAlias

from pipeline.measuring.trace import Trace
from pipeline.measuring.trace_entries import Dropped, Published, Refused, SetFormed, Stepped, Told
from pipeline.scheduling.topology import Topology
from tools.watching.trace_relations import MessageKey, Relations

#: Groups of tracks; the format calls them processes.
THREADS, STAGES, EDGES = 1, 2, 3

TraceEvent: TypeAlias = dict[str, Any]
Place: TypeAlias = tuple[int, int]  #: a point of a thread's track: (tid, ns)
Part: TypeAlias = tuple[str, int, int, Mapping[str, Any]]  #: of a run: name, from, to, arguments


def write_trace(trace: Trace, topology: Topology, graph: str, path: Path) -> None:
    """Write the trace as JSON, compressed where the name ends in ``.gz``. Raises OSError."""
    about = {"graph": graph, "entries": trace.recorded, "overwritten": trace.overwritten}
    with _opened(path) as file:
        file.write(f'{{"displayTimeUnit":"ms","otherData":{json.dumps(about)},"traceEvents":[\n')
        for number, event in enumerate(trace_events(trace, topology)):
            file.write(("" if number == 0 else ",\n") + json.dumps(event, separators=(",", ":")))
        file.write("\n]}\n")


def trace_events(trace: Trace, topology: Topology) -> Iterator[TraceEvent]:
    """Every trace event; slices before what they hold and before the arrows between them."""
    return _Drawing(trace, topology).events()


def _opened(path: Path) -> IO[str]:
    return gzip.open(path, "wt", compresslevel=5) if path.suffix == ".gz" else path.open("w")


class _Drawing:
    def __init__(self, trace: Trace, topology: Topology) -> None:
        self._entries = entries = trace.entries()
        self._overwritten = trace.overwritten
        self._is = Relations(entries, topology)
        self._start = min((entry.at for entry in entries), default=0)
        self._end = max((getattr(entry, "end", entry.at) for entry in entries), default=0)
        self._tracks: dict[tuple[int, str], int] = {}

    def events(self) -> Iterator[TraceEvent]:
        yield from self._thread_slices()
        yield from self._run_slices()
        yield from self._instants()
        yield from self._ages()
        yield from self._arrows()
        # Known only now; the format lets them stand anywhere.
        for pid, name in ((THREADS, "threads"), (STAGES, "stages"), (EDGES, "edges: losses")):
            yield _named("process_name", pid, 0, name=name)
            yield _named("process_sort_index", pid, 0, sort_index=pid)
        for (pid, name), tid in self._tracks.items():
            yield _named("thread_name", pid, tid, name=name)

    def _track(self, pid: int, name: str) -> int:
        return self._tracks.setdefault((pid, name), len(self._tracks) + 1)

    def _us(self, at: int) -> float:
        return (at - self._start) / 1e3

    # ------------------------------------------------------------------ slices

    def _thread_slices(self) -> Iterator[TraceEvent]:
        for sampled, message in self._is.samples:
            tid = self._track(THREADS, sampled.thread)
            yield self._slice(f"make {sampled.stage}", "source", tid, sampled.at, sampled.made)
            args = {"number": message.seq, "stamp_s": message.stamp / 1e9}
            yield self._slice(sampled.stage, "sample", tid, message.at, sampled.end, args)
        for steps in self._is.steps.values():
            for step in steps:
                name = step.stage if step.step == "process" else f"{step.stage} {step.step}"
                args = {"run": step.number}
                tid = self._track(THREADS, step.thread)
                yield self._slice(name, "step", tid, step.at, step.end, args)

    def _slice(
        self,
        name: str,
        category: str,
        tid: int,
        at: int,
        end: int,
        args: Mapping[str, Any] | None = None,
    ) -> TraceEvent:
        times = {"ts": self._us(at), "dur": (end - at) / 1e3}
        event = {"ph": "X", "name": name, "cat": category, "pid": THREADS, "tid": tid}
        return event | times | {"args": args or {}}

    def _run_slices(self) -> Iterator[TraceEvent]:
        """Each run from the arrival of its trigger to its end, divided into waits and steps."""
        for serial, (key, formed) in enumerate(self._is.sets.items()):
            ended = self._is.ended.get(key)
            end = ended.at if ended else self._end
            args = {
                "run": formed.number,
                "stamp_s": formed.trigger / 1e9,
                "ended": ended.how if ended else "not over",
            }
            parts = self._parts(formed, end)
            yield self._nested("b", serial, formed.stage, parts[0][1], args)
            for name, since, until, details in parts:
                if until > since:
                    yield self._nested("b", serial, name, since, details)
                    yield self._nested("e", serial, name, until)
            yield self._nested("e", serial, formed.stage, end)

    def _parts(self, formed: SetFormed, end: int) -> list[Part]:
        trigger = next((use.last for use in self._is.uses(formed) if use.is_trigger), None)
        arrived = trigger.at if trigger else formed.at
        several = len(self._is.nodes[formed.stage].inputs) > 1
        name = "wait for inputs and turn" if several else "wait for its turn"
        parts: list[Part] = [(name, arrived, formed.at, self._decision(formed, arrived))]
        before = formed.at
        for step in self._is.steps.get((formed.stage, formed.number), ()):
            if before <= step.at and step.end <= end:  # not what came back after it was given up
                name = f"{step.step} on {step.device}" if step.device else step.step
                parts.append((f"wait for {step.device or 'a worker'}", before, step.at, {}))
                parts.append((name, step.at, step.end, {}))
                before = step.end
        return [*parts, ("wait to leave in order", before, end, {})]

    def _decision(self, formed: SetFormed, arrived: int) -> dict[str, Any]:
        """What sync chose on each edge: how far from the trigger, how long after it it came."""
        found: dict[str, Any] = {}
        for use in self._is.uses(formed):
            if not use.is_trigger and use.last is not None:
                found[use.name] = {
                    "messages": len(use.keys),
                    "gap_ms": (use.last.stamp - formed.trigger) / 1e6,
                    "came_ms": (use.last.at - arrived) / 1e6,
                }
        return found | {f"{name} {edge + 1}": mark for name, edge, mark in formed.marks}

    def _nested(
        self, phase: str, serial: int, name: str, at: int, args: Mapping[str, Any] | None = None
    ) -> TraceEvent:
        event = {"ph": phase, "name": name, "cat": "run", "id": hex(serial)}
        place = {"pid": STAGES, "tid": 0, "ts": self._us(at)}
        return event | place | ({"args": args} if args else {})

    # ------------------------------------------------------------------ instants and counters

    def _instants(self) -> Iterator[TraceEvent]:
        if self._overwritten:
            text = f"{self._overwritten} older entries were overwritten"
            yield self._event(text, self._start, {})
        for entry in self._entries:
            match entry:
                case Dropped():
                    track = f"{entry.origin}/{entry.port} to {entry.stage}/{entry.name}"
                    args: dict[str, Any] = {"number": entry.seq, "stamp_s": entry.stamp / 1e9}
                    came = self._is.published.get((entry.origin, entry.port, entry.seq))
                    if came is not None:
                        args["held_ms"] = (entry.at - came.at) / 1e6
                    yield self._loss(entry, track, args)
                case Refused():
                    track = f"{entry.stage}/{entry.port}: refused"
                    yield self._loss(entry, track, {"stamp_s": entry.stamp / 1e9})
                case Told():
                    name = f"{entry.kind} {entry.subject}"
                    yield self._event(name, entry.at, {"text": entry.text})
                case _:
                    pass

    def _loss(self, entry: Dropped | Refused, track: str, args: Mapping[str, Any]) -> TraceEvent:
        event = {"ph": "i", "name": entry.reason, "cat": "loss", "s": "t", "pid": EDGES}
        place = {"tid": self._track(EDGES, track), "ts": self._us(entry.at)}
        return event | place | {"args": args}

    def _event(self, name: str, at: int, args: Mapping[str, Any]) -> TraceEvent:
        event = {"ph": "i", "name": name, "cat": "event", "s": "g", "pid": STAGES, "tid": 0}
        return event | {"ts": self._us(at), "args": args}

    def _ages(self) -> Iterator[TraceEvent]:
        """The age of each sensor's oldest sample in what stages say, when it was published."""
        for entry in self._entries:
            if isinstance(entry, Published) and not self._is.nodes[entry.stage].is_source:
                ages = {stream: (entry.now - stamp) / 1e6 for stream, stamp in entry.oldest}
                name = f"age of {entry.stage}/{entry.port} (ms)"
                event = {"ph": "C", "name": name, "cat": "age", "pid": STAGES, "tid": 0}
                yield event | {"ts": self._us(entry.at), "args": ages}

    # ------------------------------------------------------------------ arrows

    def _arrows(self) -> Iterator[TraceEvent]:
        """From step to step of a run, and from each message (of a span: the first and the last) to
        the runs that used it."""
        serial = count(1)
        origins: dict[MessageKey, Place] = {
            (message.stage, message.port, message.seq): (
                self._track(THREADS, sampled.thread),
                message.at,
            )
            for sampled, message in self._is.samples
        }
        for key, run in self._is.made_by.items():
            if run in self._is.steps:
                origins[key] = self._leaving(self._is.steps[run][-1])
        for run, steps in self._is.steps.items():
            enters = [(self._track(THREADS, step.thread), step.at) for step in steps]
            for step, place in zip(steps, enters[1:], strict=False):
                yield from self._arrow("run", next(serial), self._leaving(step), place)
            formed = self._is.sets.get(run)
            for use in self._is.uses(formed) if formed else ():
                for key in dict.fromkeys((*use.keys[:1], *use.keys[-1:])):
                    if key in origins:
                        yield from self._arrow("message", next(serial), origins[key], enters[0])

    def _leaving(self, step: Stepped) -> Place:
        """A place inside of the slice of a step, close to its end."""
        inside = min(1000, (step.end - step.at) // 2)
        return self._track(THREADS, step.thread), step.end - inside

    def _arrow(self, category: str, serial: int, since: Place, to: Place) -> Iterator[TraceEvent]:
        for phase, (tid, at), binding in (("s", since, {}), ("f", to, {"bp": "e"})):
            event = {"ph": phase, "name": category, "cat": category, "id": serial}
            yield event | {"pid": THREADS, "tid": tid, "ts": self._us(at)} | binding


def _named(kind: str, pid: int, tid: int, **args: Any) -> TraceEvent:
    return {"ph": "M", "name": kind, "pid": pid, "tid": tid, "ts": 0, "args": args}
