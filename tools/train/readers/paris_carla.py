"""Paris-CARLA-3D: clouds of a driven street as PLY, with CARLA's tags; seen from above the vehicle.

Read are x, y, z, the tag (`semantic`, `label`, `class`), `intensity`, the time (`timestamp`,
`time`, `gps_time`) and where the sensor was (x_origin, y_origin, z_origin or x_lidar_position ...).
Where the file has no positions, a text file NAME.path.txt beside it gives them: time x y z a line.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from stages.labeled_files import LabelSet
from stages.ply_file import Ply, read_ply
from tools.train.aggregated import AggregatedCloud, SimulatedViews

TAGS = ("semantic", "label", "class", "scalar_label")
TIMES = ("timestamp", "time", "gps_time", "scalar_timestamp")
ORIGINS = ("{}_origin", "{}_lidar_position", "{}_sensor")
#: Of the set's LiDAR, an HDL-32E: a revolution is a scan.
SCAN_S = 0.1
SETS = ("train", "Paris", "paris", "training")


def fits(path: Path) -> bool:
    """A PLY file, or a folder of them."""
    return bool(_files(path))


def open_views(path: Path) -> SimulatedViews:
    """Views of one file, or of the first folder's files as one street each. Raises DataError."""
    files = _files(path)
    if not files:
        raise DataError(f"{path}: holds no *.ply")
    if len(files) > 1:
        raise DataError(
            f"{path}: holds {len(files)} streets; name them one by one in a mixture, e.g. "
            f"{{path: {files[0].name}, share: 1}}"
        )
    cloud = read_cloud(files[0])
    return SimulatedViews(f"views over {files[0].name}, {len(cloud.path):,} scans", cloud, every=5)


def read_cloud(path: Path) -> AggregatedCloud:
    """The street in a file. Raises DataError with what it lacks."""
    ply = read_ply(path)
    tags, times = ply.column(*TAGS), ply.column(*TIMES)
    if tags is None:
        raise DataError(f"{path}: its points have no tags (a property {' or '.join(TAGS)})")
    if times is None:
        raise DataError(
            f"{path}: its points have no time (a property {' or '.join(TIMES)}); without it nobody "
            "knows what moved when"
        )
    if len(tags) == 0:
        raise DataError(f"{path}: has no points")
    points = ply.points()
    seconds = times.astype(np.float64)
    classes = LabelSet("carla").translate(tags, path).astype(np.uint8)
    scans = np.floor((seconds - seconds.min()) / SCAN_S).astype(np.int32)
    where = _path(ply, path, seconds, scans)
    center = where.mean(axis=0)  # map coordinates lose centimeters in single precision
    intensity = ply.column("intensity", "reflectance", "scalar_intensity")
    remission = np.zeros(len(points)) if intensity is None else intensity.astype(np.float64)
    strongest = 255.0 if remission.max(initial=0) > 1.5 else 1.0
    return AggregatedCloud(
        points=(points - center).astype(np.float32),
        remission=np.clip(remission / strongest, 0, 1).astype(np.float32),
        classes=classes,
        scans=scans,
        path=where - center,
    )


def _path(
    ply: Ply, path: Path, seconds: NDArray[np.float64], scans: NDArray[np.int32]
) -> NDArray[np.float64]:
    """(scans, 3) where the sensor was during each scan."""
    numbers = np.arange(int(scans.max()) + 1)
    for name in ORIGINS:
        columns = [ply.column(name.format(axis)) for axis in "xyz"]
        if all(column is not None for column in columns):
            first = np.unique(scans, return_index=True)
            known, at = first
            return np.stack(
                [
                    np.interp(numbers, known, np.asarray(c, np.float64)[at])
                    for c in columns
                    if c is not None
                ],
                axis=1,
            )
    beside = path.with_suffix(".path.txt")
    if not beside.is_file():
        raise DataError(
            f"{path}: does not say where the sensor was; give {beside.name} beside it, a line "
            "'time x y z' for each pose"
        )
    try:
        rows = np.loadtxt(beside, dtype=np.float64, ndmin=2)
        if rows.shape[1] != 4:
            raise ValueError(f"{rows.shape[1]} numbers to a line")
    except ValueError as error:
        raise DataError(f"{beside}: every line is 'time x y z' ({error})") from None
    at_s = seconds.min() + (numbers + 0.5) * SCAN_S
    return np.stack([np.interp(at_s, rows[:, 0], rows[:, k]) for k in (1, 2, 3)], axis=1)


def _files(path: Path) -> list[Path]:
    if path.suffix == ".ply":
        return [path] if path.is_file() else []
    if not path.is_dir():
        return []
    for folder in (path, *(path / name for name in SETS)):
        if found := sorted(folder.glob("*.ply")):
            return found
    return []
