"""The labeled scans at a path, in whichever public layout it has."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import DataError
from tools.train.readers import LAYOUTS
from tools.train.scan_sources import ScanSource


def open_scans(path: Path, layout: str | None = None) -> ScanSource:
    """The scans at a path, whichever layout it has, or the named one. Raises DataError."""
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
