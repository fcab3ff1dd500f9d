"""The null sink."""

from __future__ import annotations

from pipeline.message import Message
from stages.sinks.count import Count


def test_it_counts() -> None:
    sink = Count()
    for stamp in range(3):
        sink.process(Message.at(stamp, None))
    assert sink.count == 3
