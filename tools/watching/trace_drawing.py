"""Draws what one process recorded as Chrome trace events: `trace.py` says what they mean."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from pipeline.measuring.trace import Trace
from pipeline.measuring.trace_entries import Dropped, Published, Refused, SetFormed, Stepped, Told
from pipeline.scheduling.topology import Port, Role, Topology
from tools.watching.trace_relations import MessageKey, Relations

#: Groups of tracks of the first process; the format calls each a process. The next has 4, 5, 6.
THREADS, STAGES, EDGES = 1, 2, 3

TraceEvent: TypeAlias = dict[str, Any]
Place: TypeAlias = tuple[int, int, int]  #: a point of a thread's track: (pid, tid, ns)
#: A message wherever it is: its output port and stamp, which never comes twice there. Its number
#: does, where its process was started anew.
Sent: TypeAlias = tuple[str, str, int]
Part: TypeAlias = tuple[str, int, int, Mapping[str, Any]]  #: of a run: name, from, to, arguments


@dataclass(frozen=True, slots=True)
class Traced:
    """What one process recorded of its part of the graph."""

    trace: Trace
    topology: Topology
    process: str = ""  #: its tracks are named after it; empty where there is no other


class Drawing:
    """The tracks of one process, from the group after `first` on."""

    def __init__(self, traced: Traced, first: int, serial: Iterator[int]) -> None:
        self.entries = entries = traced.trace.entries()
        self.start = min((entry.at for entry in entries), default=0)  #: of the file: all times
        self._process = traced.process
        self._overwritten = traced.trace.overwritten
        self._is = Relations(entries, traced.topology)
        self._end = max((getattr(entry, "end", entry.at) for entry in entries), default=0)
        self._groups = self._threads, self._stages, self._edges = (
            first + THREADS,
            first + STAGES,
            first + EDGES,
        )
        self._serial = serial
        self._tracks: dict[tuple[int, str], int] = {}

    def slices(self) -> Iterator[TraceEvent]:
        """All but what concerns other processes, too."""
        yield from self._thread_slices()
        yield from self._run_slices()
        yield from self._instants()
        yield from self._ages()

    def names(self, groups: Collection[int]) -> Iterator[TraceEvent]:
        """Of the tracks, known when all are drawn, and of those `groups` that have some; the format
        lets them stand anywhere."""
        before = f"{self._process}: " if self._process else ""
        names = ("threads", "stages", "edges: losses")
        for pid, name in zip(self._groups, names, strict=True):
            if pid not in groups:
                continue
            yield _named("process_name", pid, 0, name=before + name)
            yield _named("process_sort_index", pid, 0, sort_index=pid)
        for (pid, name), tid in self._tracks.items():
            yield _named("thread_name", pid, tid, name=name)

    def _track(self, pid: int, name: str) -> int:
        key = pid, name
        if key not in self._tracks:
            self._tracks[key] = next(self._serial)
        return self._tracks[key]

    def _us(self, at: int) -> float:
        return (at - self.start) / 1e3

    # ------------------------------------------------------------------ slices

    def _thread_slices(self) -> Iterator[TraceEvent]:
        for sampled, message in self._is.samples:
            tid = self._track(self._threads, sampled.thread)
            yield self._slice(f"make {sampled.stage}", "source", tid, sampled.at, sampled.made)
            args = {"number": message.seq, "stamp_s": message.stamp / 1e9}
            yield self._slice(sampled.stage, "sample", tid, message.at, sampled.end, args)
        for steps in self._is.steps.values():
            for step in steps:
                name = step.stage if step.step == "process" else f"{step.stage} {step.step}"
                args = {"run": step.number}
                tid = self._track(self._threads, step.thread)
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
        event = {"ph": "X", "name": name, "cat": category, "pid": self._threads, "tid": tid}
        return event | times | {"args": args or {}}

    def _run_slices(self) -> Iterator[TraceEvent]:
        """Each run from the arrival of its trigger to its end, divided into waits and steps."""
        for key, formed in self._is.sets.items():
            serial = next(self._serial)
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
        sends = self._is.nodes[formed.stage].role is Role.SENDER
        name = "until it is taken" if sends else "wait to leave in order"
        return [*parts, (name, before, end, {})]

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
        place = {"pid": self._stages, "tid": 0, "ts": self._us(at)}
        return event | place | ({"args": args} if args else {})

    # ------------------------------------------------------------------ instants and counters

    def _instants(self) -> Iterator[TraceEvent]:
        if self._overwritten:
            text = f"{self._overwritten} older entries were overwritten"
            yield self._event(text, self.start, {})
        for entry in self.entries:
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
        event = {"ph": "i", "name": entry.reason, "cat": "loss", "s": "t", "pid": self._edges}
        place = {"tid": self._track(self._edges, track), "ts": self._us(entry.at)}
        return event | place | {"args": args}

    def _event(self, name: str, at: int, args: Mapping[str, Any]) -> TraceEvent:
        event = {"ph": "i", "name": name, "cat": "event", "s": "g", "pid": self._stages, "tid": 0}
        return event | {"ts": self._us(at), "args": args}

    def _ages(self) -> Iterator[TraceEvent]:
        """The age of each sensor's oldest sample in what stages say, when it was published."""
        for entry in self.entries:
            if isinstance(entry, Published) and not self._is.nodes[entry.stage].is_source:
                ages = {stream: (entry.now - stamp) / 1e6 for stream, stamp in entry.oldest}
                name = f"age of {entry.stage}/{entry.port} (ms)"
                event = {"ph": "C", "name": name, "cat": "age", "pid": self._stages, "tid": 0}
                yield event | {"ts": self._us(entry.at), "args": ages}

    # ------------------------------------------------------------------ between processes

    def made(self) -> Iterator[tuple[Sent, int]]:
        """When each message of this process was published."""
        for entry in self._is.published.values():
            if self._is.nodes[entry.stage].role is not Role.REMOTE:
                yield (entry.stage, entry.port, entry.stamp), entry.at

    def ways(self, made: Mapping[Sent, int]) -> Iterator[TraceEvent]:
        """Of each message of another process, from when it was `made` until it arrived here."""
        for entry in self._is.published.values():
            since = made.get((entry.stage, entry.port, entry.stamp), entry.at)
            if since < entry.at:
                serial, name = next(self._serial), f"{Port(entry.stage, entry.port)} on its way"
                args = {"number": entry.seq, "stamp_s": entry.stamp / 1e9}
                yield self._nested("b", serial, name, since, args)
                yield self._nested("e", serial, name, entry.at)

    def origins(self) -> Iterator[tuple[Sent, Place]]:
        """Where the arrows from each message of this process begin."""
        for sampled, message in self._is.samples:
            tid = self._track(self._threads, sampled.thread)
            yield _sent(message), (self._threads, tid, message.at)
        for key, run in self._is.made_by.items():
            if run in self._is.steps:
                yield _sent(self._is.published[key]), self._leaving(self._is.steps[run][-1])

    # ------------------------------------------------------------------ arrows

    def arrows(self, origins: Mapping[Sent, Place]) -> Iterator[TraceEvent]:
        """From step to step of a run, and from each message (of a span: the first and the last) to
        the runs that used it."""
        for run, steps in self._is.steps.items():
            enters = [
                (self._threads, self._track(self._threads, step.thread), step.at) for step in steps
            ]
            for step, place in zip(steps, enters[1:], strict=False):
                yield from self._arrow("run", self._leaving(step), place)
            formed = self._is.sets.get(run)
            for use in self._is.uses(formed) if formed else ():
                for origin in self._origins_of(use.keys, origins):
                    yield from self._arrow("message", origin, enters[0])

    def _origins_of(
        self, keys: Sequence[MessageKey], origins: Mapping[Sent, Place]
    ) -> Iterator[Place]:
        for key in dict.fromkeys((*keys[:1], *keys[-1:])):
            message = self._is.published.get(key)
            if message is not None and _sent(message) in origins:
                yield origins[_sent(message)]

    def _leaving(self, step: Stepped) -> Place:
        """A place inside of the slice of a step, close to its end."""
        inside = min(1000, (step.end - step.at) // 2)
        tid = self._track(self._threads, step.thread)
        return self._threads, tid, step.end - inside

    def _arrow(self, category: str, since: Place, to: Place) -> Iterator[TraceEvent]:
        serial = next(self._serial)
        for phase, (pid, tid, at), binding in (("s", since, {}), ("f", to, {"bp": "e"})):
            event = {"ph": phase, "name": category, "cat": category, "id": serial}
            yield event | {"pid": pid, "tid": tid, "ts": self._us(at)} | binding


def _sent(message: Published) -> Sent:
    return message.stage, message.port, message.stamp


def _named(kind: str, pid: int, tid: int, **args: Any) -> TraceEvent:
    return {"ph": "M", "name": kind, "pid": pid, "tid": tid, "ts": 0, "args": args}
