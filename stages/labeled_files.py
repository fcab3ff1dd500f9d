"""Labels out of files: what a run said of points, pixels and maps, or what is true of them.

Understood are what our sinks write (label files, masks, npz of clouds, fused images and maps, PLY),
saved maps, the true map in a simulated flight, SemanticKITTI's label files, gray PNG masks, and any
PLY or npz of annotated points.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from stages.kernels.compiled import as_input
from stages.kernels.probability import read_out
from stages.labels import LabeledVoxels
from stages.ply_file import VOXEL_COMMENT, Ply, read_ply
from stages.sources.pictures import read_picture
from stages.sources.recording import Recording
from stages.taxonomy import load_taxonomy
from stages.types import CHANNELS
from stages.voxel_map import VoxelMap

#: The label set of our own files: ids of the taxonomy.
OWN = "overflight"

#: Where a simulated flight keeps its true map.
TRUE_MAP = "truth/map"

#: What the files of labeled frames end in.
FRAMES = (".label", ".npz", ".png")

#: Names under which annotated files keep the classes and the places of points.
LABELS = ("class", "classes", "label", "labels", "semantic", "mask", "scalar_label")
POSITIONS = ("positions", "points", "xyz")

Arrays: TypeAlias = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class LabelSet:
    """How the ids in a file become ours."""

    name: str = OWN  #: a label set of the taxonomy, or `OWN`
    ignored: Collection[int] = ()  #: ids that count as unlabeled

    @classmethod
    def named(cls, name: str, ignored: Collection[int] = ()) -> LabelSet:
        """Raises DataError for a name that is no label set."""
        if name != OWN:
            try:
                load_taxonomy().label_map(name)
            except ValueError as error:
                raise DataError(f"{error}; or '{OWN}' for our own ids") from None
        return cls(name, tuple(ignored))

    def translate(self, ids: NDArray[Any], path: Path) -> NDArray[np.int64]:
        """Our ids in the shape of `ids`, 0 where ignored. Raises DataError for an unknown one."""
        taxonomy, theirs = load_taxonomy(), ids.astype(np.int64)
        if self.name == OWN:
            ours = np.where((theirs >= 0) & (theirs < len(taxonomy)), theirs, -1)
        else:
            ours = taxonomy.translate(self.name, theirs)
        ours[np.isin(theirs, list(self.ignored))] = 0
        if (ours < 0).any():
            unknown = np.unique(theirs[ours < 0])
            shown = ", ".join(map(str, unknown[:5])) + (", ..." if len(unknown) > 5 else "")
            others = ", ".join(name for name in (OWN, *taxonomy.maps) if name != self.name)
            raise DataError(
                f"{path}: label set '{self.name}' has no class {shown}; name the file's own set "
                f"({others}), or --ignore the id"
            )
        return ours


@dataclass(frozen=True, slots=True, eq=False)
class LabeledFrame:
    """A scan or an image."""

    labels: NDArray[np.int64]  #: (n,) or (height, width) ids of the taxonomy, 0 unlabeled
    points: NDArray[np.float32] | None = None  #: (n, 3) m in the sensor's frame
    sensor: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LabeledMap:
    """Voxels or points of a map."""

    points: NDArray[np.float64]  #: (n, 3) m
    labels: NDArray[np.int64]  #: (n,) ids of the taxonomy, 0 unlabeled
    entropy: NDArray[np.float32] | None = None  #: (n,) nats, where the file knows it
    voxel_m: float | None = None  #: edge of a voxel, where the file knows it


def read_frame(path: Path, labels: LabelSet) -> LabeledFrame:
    """The labels of a scan or an image. Raises DataError."""
    if path.suffix == ".label":
        return LabeledFrame(labels.translate(_label_file(path), path))
    if path.suffix == ".png":
        return LabeledFrame(labels.translate(_mask(path), path))
    arrays = read_npz(path)
    sensor = str(arrays["sensor"]) if "sensor" in arrays else None
    return LabeledFrame(_labels_of(arrays, labels, path)[0], _first(arrays, POSITIONS), sensor)


def read_map(path: Path, labels: LabelSet) -> LabeledMap:
    """A map of ours, a saved one, annotated points, or the true map of a simulated flight.

    Raises DataError.
    """
    if path.suffix == ".mcap":
        return _map_of_recording(path, labels)
    if path.suffix == ".ply":
        return _map_of_ply(read_ply(path), labels, path)
    arrays = read_npz(path)
    if "horizon" in arrays:
        with path.open("rb") as file:
            voxels = VoxelMap.load(file).snapshot()
        arrays = {"positions": voxels.positions, "log_scores": voxels.log_scores}
        arrays["voxel_m"] = np.array(voxels.voxel_m)
    points = _first(arrays, POSITIONS)
    if points is None and {"indices", "voxel_m"} <= arrays.keys():  # `stages.labels.LabeledVoxels`
        points = (arrays["indices"] + 0.5) * arrays["voxel_m"]
    if points is None or points.ndim != 2 or points.shape[1] != 3:
        raise DataError(f"{path}: holds no points; a map has an array 'positions' of shape (n, 3)")
    ours, entropy = _labels_of(arrays, labels, path)
    if len(ours) != len(points):
        raise DataError(f"{path}: {len(ours)} labels for {len(points)} points")
    voxel_m = float(arrays["voxel_m"]) if "voxel_m" in arrays else None
    return LabeledMap(points.astype(np.float64), ours, entropy, voxel_m)


def _map_of_recording(path: Path, labels: LabelSet) -> LabeledMap:
    source = Recording(path=path, topic=TRUE_MAP)
    source.open()
    message = next(source.messages(), None)
    if message is None or not isinstance(message.payload, LabeledVoxels):
        raise DataError(f"{path}: its topic {TRUE_MAP} holds no map")
    voxels = message.payload
    centers = ((voxels.indices + 0.5) * voxels.voxel_m).astype(np.float64)
    return LabeledMap(centers, labels.translate(voxels.classes, path), None, voxels.voxel_m)


def holds_map(path: Path) -> bool:
    """The file is a map and not a frame."""
    if path.suffix != ".npz":
        return path.suffix == ".ply"
    arrays = read_npz(path)
    return "evidence" not in arrays and any(
        name in arrays for name in ("horizon", "indices", *POSITIONS)
    )


def read_npz(path: Path) -> Arrays:
    """The arrays of an npz file by name. Raises DataError."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as content:
            return {name: content[name] for name in content.files}
    except (OSError, ValueError, EOFError, BadZipFile) as error:
        raise DataError(f"{path}: no npz file of plain arrays ({error})") from error


def _label_file(path: Path) -> NDArray[np.uint32]:
    """SemanticKITTI's: a uint32 per point, the class in its low 16 bits, the instance above."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from None
    if len(content) % 4:
        raise DataError(f"{path}: {len(content)} bytes are no rows of uint32; fetch it again")
    return np.frombuffer(content, dtype="<u4") & np.uint32(0xFFFF)


def _mask(path: Path) -> NDArray[Any]:
    mask = read_picture(path)
    if mask.ndim != 2:
        raise DataError(f"{path}: a color picture; a mask has one channel, of class ids")
    return mask


def _map_of_ply(ply: Ply, labels: LabelSet, path: Path) -> LabeledMap:
    ids, entropy = ply.column(*LABELS), ply.column("entropy")
    if ids is None:
        raise DataError(f"{path}: its points have no class; name a property one of {LABELS}")
    sizes = [words[1] for words in map(str.split, ply.comments) if words[:1] == [VOXEL_COMMENT]]
    return LabeledMap(
        ply.points(),
        labels.translate(ids, path),
        None if entropy is None else entropy.astype(np.float32),
        float(sizes[0]) if sizes else None,
    )


def _labels_of(
    arrays: Arrays, labels: LabelSet, path: Path
) -> tuple[NDArray[np.int64], NDArray[np.float32] | None]:
    """Class and entropy of what an npz file holds, whichever way it says it."""
    ids = _first(arrays, LABELS)
    if "boxes" in arrays:
        raise DataError(f"{path}: holds the boxes of a detector; labels of points or pixels needed")
    if ids is not None:
        return labels.translate(ids, path), None
    if "log_scores" not in arrays:
        raise DataError(f"{path}: holds neither log_scores nor one of {', '.join(LABELS)}")
    scores = arrays["log_scores"]
    if scores.ndim != 2 or scores.shape[1] != CHANNELS:
        raise DataError(f"{path}: log_scores of shape {scores.shape}, not (n, {CHANNELS})")
    label, _, entropy = read_out(as_input(scores), len(load_taxonomy()))
    said = arrays.get("evidence", np.ones(len(label), dtype=np.bool_))
    return np.where(said, label, 0).astype(np.int64), entropy


def _first(arrays: Arrays, names: Collection[str]) -> NDArray[Any] | None:
    return next((arrays[name] for name in names if name in arrays), None)
