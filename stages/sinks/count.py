"""A sink that counts and throws away: for benchmarks, and to keep an output running."""

from __future__ import annotations

from typing import Any

from pipeline.message import Message
from pipeline.stage import Stage


class Count(Stage):
    """Counts the messages it gets."""

    inline = True

    def __init__(self) -> None:
        self.count = 0

    def process(self, message: Message[Any]) -> None:
        self.count += 1
