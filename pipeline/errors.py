"""Every error that Overflight raises on purpose, in one tree.

OverflightError
├── GraphError          a graph file is wrong: carries every mistake found, each with its place
├── ModelError          a model file or registry entry is wrong, missing or does not fit its device
├── DeviceError         a device cannot be opened, or failed while it ran
├── DataError           a recording, calibration or other input file is wrong
├── StageError          a stage broke its contract (wrong return, a stamp that runs backward)
└── TransportError      processes cannot be connected: an endpoint, a key, a right, shared memory
    └── WireError       bytes from another process are not what the graph declares: refused

The command prints these without a traceback; whatever is not in this tree is a defect of ours or of
the user's own stage, and keeps its traceback.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


class OverflightError(Exception):
    """Base of all errors raised on purpose; the text names the place, the thing and the way out."""


class ModelError(OverflightError):
    """A model file or registry entry is wrong, missing, or does not fit its device."""


class DeviceError(OverflightError):
    """A device cannot be opened, or failed while it ran."""


class DataError(OverflightError):
    """A recording, calibration or other input file is wrong."""


class StageError(OverflightError):
    """A stage broke its contract."""


class TransportError(OverflightError):
    """Processes cannot be connected as the graph file says."""


class WireError(TransportError):
    """A value cannot travel, or what arrived is not what the graph declares.

    `reason` is one word of `pipeline.transport.channel.Refused`, under which it is counted.
    """

    def __init__(self, reason: str, sentence: str) -> None:
        self.reason = reason
        super().__init__(sentence)


@dataclass(frozen=True, slots=True)
class Mistake:
    """One mistake (or warning) in a graph file, with its place."""

    file: str
    line: int  #: 1-based; 0 where no line is known
    column: int  #: 1-based; 0 where no column is known
    path: str  #: the path in the file, e.g. ``stages.fuse_cloud.inputs.scores``; may be empty
    what: str  #: one sentence, with the way out

    def __str__(self) -> str:
        place = self.file
        if self.line:
            place += f":{self.line}:{self.column}"
        return f"{place}: {self.path}: {self.what}" if self.path else f"{place}: {self.what}"


class GraphError(OverflightError):
    """A graph file is wrong; `mistakes` holds all of them, in the order of the file."""

    def __init__(self, mistakes: Sequence[Mistake]) -> None:
        self.mistakes = tuple(mistakes)
        super().__init__("\n".join(str(mistake) for mistake in self.mistakes))
