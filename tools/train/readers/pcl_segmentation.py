"""The sample set of PCLSegmentation (RWTH Aachen): range images of a VLP-32's forward sector.

A file is a float array (rows, columns, 6): x, y, z, intensity, range and the class.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.errors import DataError
from stages.taxonomy import load_taxonomy
from tools.train.scan_sources import LabeledPoints, ListedScans

#: Their classes in order, as ours; none: unlabeled.
CLASSES = (
    *("road", "sidewalk", "building", "object", "vegetation", "person", "bicycle"),
    *("vehicle", "vehicle", "vehicle", "background"),
)


def fits(path: Path) -> bool:
    """A folder of such arrays, or of folders of them."""
    return bool(_files(path))


def open_scans(path: Path) -> ListedScans:
    """All of them. Raises DataError."""
    files = _files(path)
    if not files:
        raise DataError(f"{path}: holds no *.npy")
    return ListedScans(f"{path.name}: {len(files):,} scans of a sector", tuple(files), read)


def read(path: Path) -> LabeledPoints:
    """The scan in a file. Raises DataError."""
    try:
        image = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise DataError(f"{path}: is no array ({error})") from None
    if image.ndim != 3 or image.shape[2] != 6:
        raise DataError(f"{path}: of shape {image.shape}; a range image is (rows, columns, 6)")
    rows = image.reshape(-1, 6)
    ids = rows[:, 5].astype(np.int64)
    if ids.min() < 0 or ids.max() >= len(CLASSES):
        raise DataError(f"{path}: class {ids.max()} of {len(CLASSES)}; is it of another release?")
    taxonomy = load_taxonomy()
    ours = np.array([taxonomy.id(name) for name in CLASSES], dtype=np.uint8)
    seen = (rows[:, :3] != 0).any(axis=1) & (rows[:, 4] > 0)
    points = np.where(seen[:, None], rows[:, :3], 0).astype(np.float32)
    strongest = 255.0 if rows[:, 3].max(initial=0) > 1.5 else 1.0
    remission = np.where(seen, np.clip(rows[:, 3] / strongest, 0, 1), 0).astype(np.float32)
    return LabeledPoints(points, remission, np.where(seen, ours[ids], 0).astype(np.uint8))


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return []
    return sorted(path.glob("*.npy")) or sorted(path.glob("*/*.npy"))
