"""Labeled scans for training: what a source of them is.

One file per layout in `tools/train/readers/`; a mixture of several is a YAML file (`scan_mix`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class LabeledPoints:
    """A scan and the class of each of its points."""

    points: NDArray[np.float32]  #: (n, 3) m in the sensor's frame; 0: no return
    remission: NDArray[np.float32]  #: (n,) 0..1
    classes: NDArray[np.uint8]  #: (n,) ids of the taxonomy, 0 unlabeled
    shape: tuple[int, int] | None = None  #: of an organized scan


class ScanSource(Protocol):
    """Scans that are read when they are drawn: a set may be larger than the memory."""

    @property
    def told(self) -> str:
        """What it is, in words for the model card."""

    def __len__(self) -> int:
        """How many scans it has."""

    def read(self, number: int) -> LabeledPoints:
        """A scan; raises DataError naming the file."""


@dataclass(frozen=True, slots=True)
class ListedScans:
    """A source of files, one scan each."""

    told: str
    files: tuple[Path, ...]
    reader: Callable[[Path], LabeledPoints]

    def __len__(self) -> int:
        return len(self.files)

    def read(self, number: int) -> LabeledPoints:
        """The scan of a file."""
        return self.reader(self.files[number])


@dataclass(frozen=True, slots=True)
class HeldScans:
    """A source of scans that are in memory."""

    told: str
    scans: tuple[LabeledPoints, ...]

    def __len__(self) -> int:
        return len(self.scans)

    def read(self, number: int) -> LabeledPoints:
        """One of them."""
        return self.scans[number]
