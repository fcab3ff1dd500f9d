"""Payloads as NumPy archives, to look at them from Python."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import StageError
from pipeline.message import Message
from pipeline.stage import Stage
from stages.sinks.whole_file import whole_file


class WriteNpz(Stage):
    """Writes the payload of each `every`-th message to `folder`/`<stamp in ns>`.npz.

    One array per field of the payload (None is left out), and the message's stamp, begin and end.
    """

    def __init__(self, *, folder: Path, every: int = 1) -> None:
        if every < 1:
            raise ValueError(f"every must be at least 1, not {every}")
        self._folder = Path(folder)
        self._every = every
        self._seen = 0

    def process(self, message: Message[Any]) -> None:
        self._seen += 1
        if (self._seen - 1) % self._every:
            return
        payload = message.payload
        if not is_dataclass(payload):
            raise StageError(
                f"WriteNpz cannot write a {type(payload).__name__}; a payload is a dataclass"
            )
        content: dict[str, Any] = {
            field.name: np.asarray(value)
            for field in fields(payload)
            if (value := getattr(payload, field.name)) is not None
        }
        content |= {"stamp": message.stamp, "begin": message.begin, "end": message.end}
        with whole_file(self._folder / f"{message.stamp:020d}.npz") as file:
            np.savez(file, **content)
