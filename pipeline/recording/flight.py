"""Reads a recorded run back: what it says of itself, its events in order, its hashes and gaps."""

from __future__ import annotations

import json
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.errors import DataError
from pipeline.recording.channels import LOSSLESS, PORT
from pipeline.recording.manifest import Manifest
from pipeline.recording.mcap import Channel, McapReader
from pipeline.recording.recorder import DECISIONS
from pipeline.scheduling.topology import Port


class Event(NamedTuple):
    """One event of a scheduler, as it was recorded."""

    number: int
    name: str
    now: int
    said: tuple[Any, ...]
    followed: tuple[tuple[Any, ...], ...]


class Lost(NamedTuple):
    """A message that the recorder could not keep."""

    port: Port
    seq: int
    stamp: int
    why: str


class Page(NamedTuple):
    """What was written at once: about a tenth of a second."""

    process: str
    events: tuple[Event, ...]
    hashes: dict[tuple[Port, int], str]  #: by port and number
    lost: tuple[Lost, ...]


@dataclass(frozen=True)
class Flight:
    """A file that `overflight run --record` wrote, also one that a crash has cut short.

    Everything raises DataError where the file is damaged or holds no recorded run.
    """

    path: Path

    @cached_property
    def reader(self) -> McapReader:
        return McapReader(self.path)

    @cached_property
    def manifest(self) -> Manifest:
        """What the file says of the run."""
        notes = self.reader.notes()
        try:
            return Manifest.of(notes)
        except DataError as error:
            raise DataError(f"{self.path}: {error}") from None

    @cached_property
    def channels(self) -> dict[Port, Channel]:
        """The topics that hold the messages of a port."""
        found: dict[Port, Channel] = {}
        for channel in self.reader.channels().values():
            stage, slash, name = channel.metadata.get(PORT, "").partition("/")
            if slash:
                found[Port(stage, name)] = channel
        return found

    def is_exact(self, port: Port) -> bool:
        """Whether the messages of a port come back bit by bit."""
        channel = self.channels.get(port)
        return channel is not None and channel.metadata.get(LOSSLESS) == "true"

    def pages(self) -> Generator[Page]:
        """The decisions in their order."""
        for record in self.reader.records([DECISIONS]):
            try:
                yield _page(json.loads(record.data))
            except (ValueError, TypeError, KeyError, IndexError, RecursionError) as error:
                what = f"page {record.seq} of its decisions cannot be read ({error})"
                raise DataError(f"{self.path}: damaged: {what}; copy it again") from None

    def gap(self, before: Event | None, event: Event) -> str | None:
        """What is missing between two events; None where one follows the other."""
        expected = 0 if before is None else before.number + 1
        if event.number == expected:
            return None
        after = "the beginning" if before is None else f"{before.now / 1e9:.3f} s"
        count = event.number - expected
        return f"{count} decisions were lost between {after} and {event.now / 1e9:.3f} s"


def frozen(value: Any) -> Any:
    """The value with tuples for lists, as rows are made: to be compared and kept."""
    return tuple(map(frozen, value)) if isinstance(value, (list, tuple)) else value


def _page(data: Any) -> Page:
    return Page(
        str(data["process"]),
        tuple(_event(row) for row in data["rows"]),
        {(Port(str(stage), str(name)), int(seq)): str(h) for stage, name, seq, h in data["hashes"]},
        tuple(_lost(entry) for entry in data["lost"]),
    )


#: What may follow from an event, with the kinds of its parts.
_FOLLOWED: Mapping[str, tuple[type, ...]] = {
    "out": (str, str, int, int),
    "lost": (str, str, int, int),
    "refused": (str, str, int, str),
    "drop": (str, str, str, str, int, str),
    "set": (str, int, list, list),
    "start": (str, int, str, object),
    "check": (str,),
    "end": (str, int, str),
    "told": (str, str, str),
}


def _event(row: Any) -> Event:
    number, name, now, said, followed = row
    if not _are((number, name, now, said, followed), (int, str, int, list, list)):
        raise ValueError(f"an event {str(row)[:40]}")
    for kind, *parts in followed:
        if not _are(parts, _FOLLOWED[kind]):
            raise ValueError(f"what followed {str([kind, *parts])[:40]}")
    return Event(number, name, now, frozen(said), frozen(followed))


def _are(values: Sequence[Any], kinds: tuple[type, ...]) -> bool:
    return len(values) == len(kinds) and all(map(isinstance, values, kinds))


def _lost(entry: Any) -> Lost:
    stage, name, seq, stamp, why = entry
    return Lost(Port(str(stage), str(name)), int(seq), int(stamp), str(why))
