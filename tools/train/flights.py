"""What recorded flights hold for training: samples of a sensor, and what is true of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording.mcap import McapReader
from stages.sources.recording import Recording

#: Where `overflight simulate` puts what is true of a sensor's samples.
TRUTH = "truth/"

Payload = TypeVar("Payload")
Truth = TypeVar("Truth")


def with_truth(
    flight: Path, payload: type[Payload], truth: type[Truth], suffix: str = ""
) -> Iterator[tuple[Payload, Truth]]:
    """Every sample of a `payload`, of any sensor, with what is true at the same stamp.

    `flight` is one file, or a folder whose flights come by name. The truth of topic `rgb` lies in
    `truth/rgb` + `suffix`. Raises DataError where a file cannot be read or has none.
    """
    if flight.is_dir():
        for one in flights_in(flight):
            yield from with_truth(one, payload, truth, suffix)
        return
    topics = McapReader(flight).channels()
    found = False
    for topic in topics:
        if topic.startswith(TRUTH) or f"{TRUTH}{topic}{suffix}" not in topics:
            continue
        truths = {one.stamp: one.payload for one in messages_of(flight, f"{TRUTH}{topic}{suffix}")}
        for message in messages_of(flight, topic):
            said = truths.get(message.stamp)
            if isinstance(message.payload, payload) and isinstance(said, truth):
                found = True
                yield message.payload, said
    if not found:
        raise DataError(
            f"{flight}: has no {payload.__name__} with {truth.__name__} of the same stamp; give a "
            "flight of 'overflight simulate'"
        )


def flights_in(folder: Path) -> list[Path]:
    """The recorded flights of a folder, by name. Raises DataError where it has none."""
    found = sorted(folder.glob("*.mcap"))
    if not found:
        raise DataError(f"{folder}: holds no flight (.mcap); make one with 'overflight simulate'")
    return found


def messages_of(flight: Path, topic: str) -> Iterator[Message[Any]]:
    """The messages of a topic of an MCAP file. Raises DataError where there is none."""
    source = Recording(path=flight, topic=topic)
    source.open()
    try:
        yield from source.messages()
    finally:
        source.close()
