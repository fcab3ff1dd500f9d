"""`overflight info`: what a recording holds, how steadily it came, and what is missing."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import median_low
from typing import Any

from rich.console import Console
from rich.table import Table

from pipeline.errors import DataError
from pipeline.recording.channels import LOSSLESS, topic_of
from pipeline.recording.codec import PAYLOAD
from pipeline.recording.flight import Event, Flight
from pipeline.recording.manifest import NOTE, Manifest
from pipeline.recording.mcap import Channel
from pipeline.recording.recorder import DECISIONS
from pipeline.scheduling.topology import Port

#: Delays that are kept per stream for their median.
_DELAYS = 100_000
#: Topics that stand for the whole flight.
_CALIBRATION = "calibration/"


@dataclass(slots=True)
class _Stream:
    """One stream as it is walked along."""

    count: int = 0
    first: int = 0
    last: int = 0
    longest_gap: int = 0
    gap_at: int = 0
    delays: list[int] = field(default_factory=list)

    def add(self, stamp: int, arrived: int) -> None:
        if self.count == 0:
            self.first = self.last = stamp
        if stamp - self.last > self.longest_gap:
            self.longest_gap, self.gap_at = stamp - self.last, self.last
        self.count, self.last = self.count + 1, max(self.last, stamp)
        if len(self.delays) < _DELAYS:
            self.delays.append(arrived - stamp)


@dataclass(frozen=True, slots=True)
class Topic:
    """One stream of a recording."""

    name: str
    schema: str | None  #: None: only its hashes and times were recorded
    payload: str | None
    lossless: bool | None
    messages: int  #: written
    published: int | None  #: taken by the port in the flight; None where no decisions tell
    lost: int
    rate_hz: float | None
    longest_gap_ms: float | None  #: between two stamps
    gap_at_s: float | None
    delay_ms: float | None  #: median, from the stamp to the arrival


@dataclass(frozen=True, slots=True)
class Info:
    """A recording, described."""

    path: str
    bytes: int
    whole: bool  #: False: it was cut short, and is readable up to its last chunk
    duration_s: float
    begin_s: float
    topics: tuple[Topic, ...]
    run: dict[str, Any] | None  #: graph, versions, machine; None where it holds no run of ours
    decisions: int
    gap: str | None  #: the first reason why it cannot be re-enacted
    first_loss: str | None
    recorder: dict[str, Any] | None  #: its own statistics, in a file that was finished
    notes: dict[str, dict[str, str]]  #: of other programs


def describe(path: Path) -> Info:
    """Walk through a file. Raises DataError."""
    flight = Flight(path)
    reader = flight.reader
    notes = reader.notes()
    channels = reader.channels()
    manifest = Manifest.of(notes) if NOTE in notes else None
    walk = _Walk(flight)
    if DECISIONS in channels:
        walk.decisions()
    walk.records([name for name in channels if name != DECISIONS])
    begins = [stream.first for stream in walk.streams.values() if stream.count]
    ends = [stream.last for stream in walk.streams.values() if stream.count]
    begin, end = min(begins, default=0), max(ends, default=0)
    finished = notes.get("recording", {}).get("statistics")
    return Info(
        path=str(path),
        bytes=path.stat().st_size,
        whole=reader.is_whole(),
        duration_s=round((end - begin) / 1e9, 3),
        begin_s=begin / 1e9,
        topics=tuple(_topics(walk, channels)),
        run=None if manifest is None else _run(manifest),
        decisions=walk.events,
        gap=walk.gap,
        first_loss=walk.first_loss,
        recorder=None if finished is None else _read(finished, path),
        notes={name: values for name, values in notes.items() if name not in (NOTE, "recording")},
    )


class _Walk:
    """What is counted along a file."""

    def __init__(self, flight: Flight) -> None:
        self._flight = flight
        self.streams: dict[str, _Stream] = {}
        self.written: dict[str, int] = {}
        self.lost: dict[str, int] = {}
        self.from_decisions = False
        self.events = 0
        self.gap: str | None = None
        self.first_loss: str | None = None

    def decisions(self) -> None:
        self.from_decisions = True
        last: Event | None = None
        for page in self._flight.pages():
            for event in page.events:
                self.gap = self.gap or self._flight.gap(last, event)
                self.events += 1
                last = event
                for kind, *row in event.followed:
                    if kind == "out":
                        topic = topic_of(Port(row[0], row[1]))
                        self.streams.setdefault(topic, _Stream()).add(row[3], event.now)
                    elif kind == "lost":
                        why = "the recorder's buffer was full"
                        self._lose(Port(row[0], row[1]), row[3], why)
            for lost in page.lost:
                self._lose(lost.port, lost.stamp, lost.why)

    def _lose(self, port: Port, stamp: int, why: str) -> None:
        topic = topic_of(port)
        self.lost[topic] = self.lost.get(topic, 0) + 1
        self.first_loss = self.first_loss or f"{port} at stamp {stamp / 1e9:.6f} s: {why}"

    def records(self, topics: list[str]) -> None:
        for record in self._flight.reader.records(topics):
            self.written[record.topic] = self.written.get(record.topic, 0) + 1
            if not self.from_decisions and not record.topic.startswith(_CALIBRATION):
                stream = self.streams.setdefault(record.topic, _Stream())
                stream.add(record.stamp, record.received)


def _topics(walk: _Walk, channels: dict[str, Channel]) -> Iterator[Topic]:
    names = [name for name in channels if name != DECISIONS]
    for name in dict.fromkeys([*names, *walk.streams]):
        channel = channels.get(name)
        stream = walk.streams.get(name, _Stream())
        span = stream.last - stream.first
        lossless = None if channel is None else channel.metadata.get(LOSSLESS)
        yield Topic(
            name=name,
            schema=None if channel is None else channel.schema,
            payload=None if channel is None else channel.metadata.get(PAYLOAD),
            lossless=None if lossless is None else lossless == "true",
            messages=walk.written.get(name, 0),
            published=stream.count if walk.from_decisions and stream.count else None,
            lost=walk.lost.get(name, 0),
            rate_hz=round((stream.count - 1) * 1e9 / span, 3) if span > 0 else None,
            longest_gap_ms=round(stream.longest_gap / 1e6, 3) if stream.count > 1 else None,
            gap_at_s=stream.gap_at / 1e9 if stream.count > 1 else None,
            delay_ms=round(median_low(stream.delays) / 1e6, 3) if stream.delays else None,
        )


def _run(manifest: Manifest) -> dict[str, Any]:
    page = asdict(manifest)
    del page["topology"]
    return page


def _read(text: str, path: Path) -> dict[str, Any]:
    try:
        page = json.loads(text)
    except ValueError as error:
        raise DataError(f"{path}: damaged: the recorder's own count ({error})") from None
    return page if isinstance(page, dict) else {}


def print_info(info: Info, console: Console) -> None:
    """The same for a person."""
    size = info.bytes / 1e6
    rate = size / info.duration_s if info.duration_s else 0.0
    console.print(f"{info.path}: {info.duration_s:.2f} s, {size:.1f} MB ({rate:.1f} MB/s)")
    if not info.whole:
        text = "It was cut short (a crash, a full disk); everything up to its last chunk is here."
        console.print(text, style="yellow")
    if info.run is not None:
        _print_run(info, console)
    calibrated = sum(topic.name.startswith(_CALIBRATION) for topic in info.topics)
    if calibrated:
        console.print(f"With its calibration ({calibrated} topics)")
    console.print(_table(info))
    console.print(
        "gap: the longest between two stamps. delay: median from the stamp to the arrival. exact: "
        "bit by bit, as --as-recorded needs it of every source.",
        style="dim",
    )
    if info.first_loss is not None:
        console.print(f"First message that is missing: {info.first_loss}", style="yellow")
    if info.gap is not None:
        console.print(f"Decisions are missing: {info.gap}", style="yellow")
    for name, values in info.notes.items():
        keys = ", ".join(f"{key} {_short(value)}" for key, value in values.items())
        console.print(f"{name}: {keys}", style="dim", highlight=False)


def _print_run(info: Info, console: Console) -> None:
    run = info.run
    assert run is not None
    of = f", process {run['process']}" if run["process"] else ""
    mode = "offline" if run["offline"] else "live"
    console.print(f"Graph {run['graph']}{of}, run {mode} on {run['started']}")
    console.print(
        f"{run['machine'].get('cpu', 'unknown CPU')}; "
        + ", ".join(f"{name} {version}" for name, version in run["versions"].items()),
        style="dim",
        highlight=False,
    )
    console.print(f"{info.decisions:,} scheduler events with all that followed from them")
    ended = (info.recorder or {}).get("ended_early")
    if ended:
        console.print(f"The recording ended before the flight: {ended}", style="yellow")


def _table(info: Info) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("topic", no_wrap=True)
    table.add_column("holds", no_wrap=True)
    for title in ("messages", "lost", "Hz", "gap ms", "delay ms"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("exact", no_wrap=True)
    for topic in info.topics:
        if topic.name.startswith(_CALIBRATION):
            continue
        hashed = topic.schema is None
        count = topic.published if hashed else topic.messages
        table.add_row(
            topic.name,
            "hashes only" if hashed else topic.payload or str(topic.schema).rpartition(".")[2],
            f"{count:,}",
            f"{topic.lost:,}" if topic.lost else "",
            "" if topic.rate_hz is None else f"{topic.rate_hz:.2f}",
            "" if topic.longest_gap_ms is None else f"{topic.longest_gap_ms:.0f}",
            "" if topic.delay_ms is None else f"{topic.delay_ms:.1f}",
            "" if topic.lossless is None else "yes" if topic.lossless else "no",
            style="dim" if hashed else "",
        )
    return table


def _short(value: str) -> str:
    return value if len(value) <= 40 else f"{value[:37]}..."
