"""Simulated flights: every LiDAR's scans with what is true of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stages.labels import Labels
from stages.types import Scan
from tools.train.flights import flights_in, with_truth
from tools.train.scan_sources import HeldScans, LabeledPoints


def fits(path: Path) -> bool:
    """A flight, or a folder of flights."""
    return path.suffix == ".mcap" or (path.is_dir() and any(path.glob("*.mcap")))


def open_scans(path: Path) -> HeldScans:
    """All scans of the flights, in memory: a minute at 4 Hz is 0.5 GB. Raises DataError."""
    files = flights_in(path) if path.is_dir() else [path]
    scans = [
        LabeledPoints(
            scan.points,
            np.zeros(len(scan.points), np.float32) if scan.remission is None else scan.remission,
            truth.classes.ravel(),
            scan.shape,
        )
        for file in files
        for scan, truth in with_truth(file, Scan, Labels)
    ]
    names = ", ".join(file.name for file in files)
    return HeldScans(f"{names}: {len(scans):,} scans", tuple(scans))
