"""Labeled scans from folders in public layouts: what a source is, and which one a path is.

One file per layout in `tools/train/readers/`; a mixture of several is a YAML file (`scan_mix`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError


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


def open_scans(path: Path, layout: str | None = None) -> ScanSource:
    """The scans at a path, whichever layout it has, or the named one. Raises DataError."""
    from tools.train.readers import LAYOUTS

    if not path.exists():
        raise DataError(f"{path}: no such file or folder")
    if layout is not None:
        if layout not in LAYOUTS:
            raise DataError(f"{path}: no layout '{layout}' (known: {', '.join(LAYOUTS)})")
        return LAYOUTS[layout].open(path)
    for one in LAYOUTS.values():
        if one.fits(path):
            return one.open(path)
    looked = "; ".join(f"{name}: {one.looks_like}" for name, one in LAYOUTS.items())
    raise DataError(f"{path}: no labeled scans found; looked for {looked}")
