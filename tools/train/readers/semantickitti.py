"""SemanticKITTI's layout: velodyne/NNNNNN.bin beside labels/NNNNNN.label, in one sequence or many.

`overflight propagate` writes it too, and says in sequence.yaml what the layout cannot: whose ids
the labels are, and the rows and columns of an organized scan.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pipeline.errors import DataError
from stages.labeled_files import LabelSet
from stages.sources.kitti_files import read_bin
from tools.train.scan_sources import LabeledPoints, ListedScans

SIDECAR = "sequence.yaml"


def fits(path: Path) -> bool:
    """A sequence, or a folder of sequences."""
    return bool(_sequences(path))


def open_scans(path: Path) -> ListedScans:
    """The scans that have labels, of all sequences below. Raises DataError."""
    sequences = _sequences(path)
    if not sequences:
        raise DataError(f"{path}: holds no velodyne/ beside labels/, nor sequences/NN that do")
    files: list[Path] = []
    readers: dict[Path, Any] = {}
    for sequence in sequences:
        side = _sidecar(sequence)
        found = sorted((sequence / "labels").glob("*.label"))
        if not found:
            raise DataError(f"{sequence}: has no labels/*.label; is it a test sequence?")
        for label in found:
            scan = sequence / "velodyne" / f"{label.stem}.bin"
            if not scan.is_file():
                raise DataError(
                    f"{label}: its scan {scan.name} is missing in {scan.parent}; fetch it too"
                )
            files.append(label)
            readers[label] = partial(_read, scan=scan, side=side)
    names = ", ".join(sequence.name for sequence in sequences)
    return ListedScans(f"{names}: {len(files):,} scans", tuple(files), lambda f: readers[f](f))


def _sequences(path: Path) -> list[Path]:
    if (path / "labels").is_dir() and (path / "velodyne").is_dir():
        return [path]
    for root in (path / "sequences", path / "dataset" / "sequences"):
        if root.is_dir():
            return sorted(
                one for one in root.iterdir()
                if (one / "labels").is_dir() and (one / "velodyne").is_dir()
            )  # fmt: skip
    return []


def _sidecar(sequence: Path) -> tuple[LabelSet, tuple[int, int] | None]:
    file = sequence / SIDECAR
    if not file.is_file():
        return LabelSet("semantickitti"), None
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
        shape = content.get("shape")
        name = str(content.get("labels", "semantickitti"))
        return LabelSet.named(name), (int(shape[0]), int(shape[1])) if shape else None
    except (OSError, yaml.YAMLError, AttributeError, TypeError, ValueError, IndexError) as error:
        raise DataError(f"{file}: says nothing of labels and shape ({error})") from None


def _read(label: Path, scan: Path, side: tuple[LabelSet, tuple[int, int] | None]) -> LabeledPoints:
    label_set, shape = side
    points, remission = read_bin(scan)
    content = label.read_bytes()
    if len(content) != 4 * len(points):
        raise DataError(
            f"{label}: {len(content) // 4} labels for the {len(points)} points of {scan.name}; one "
            "of them is cut short or of another release"
        )
    raw = np.frombuffer(content, dtype="<u4") & 0xFFFF
    classes = label_set.translate(raw, label).astype(np.uint8)
    if shape is not None and shape[0] * shape[1] != len(points):
        raise DataError(f"{label}: {len(points)} points are no {shape[0]} x {shape[1]} scan")
    return LabeledPoints(points, np.clip(remission, 0, 1), classes, shape)
