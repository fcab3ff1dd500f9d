"""The file formats of drives of the KITTI family; every reader raises DataError naming the file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError

#: (n, 3) m in the LiDAR frame and (n,) remission 0..1
Points: TypeAlias = tuple[NDArray[np.float32], NDArray[np.float32]]
Matrix: TypeAlias = NDArray[np.float64]


def read_npz(path: Path) -> Points:
    """Arrays xyz, int16 in counts of 4 mm, and inten, uint8."""
    try:
        with np.load(path, allow_pickle=False) as arrays:
            points = arrays["xyz"].astype(np.float32) * np.float32(0.004)
            return points.reshape(-1, 3), arrays["inten"].astype(np.float32) / np.float32(255.0)
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise DataError(f"{path}: no scan of arrays xyz and inten ({error})") from error


def read_bin(path: Path) -> Points:
    """Rows of x y z remission, float32."""
    content = _bytes(path)
    if len(content) % 16:
        raise DataError(f"{path}: {len(content)} bytes are no rows of four float32; fetch it again")
    return _split(np.frombuffer(content, dtype="<f4"))


def read_pcd(path: Path) -> Points:
    """Binary PCD 0.7 with x y z intensity; some exporters pad the file with zeros at the end."""
    content = _bytes(path)
    head, found, body = content.partition(b"DATA binary\n")
    lines = (line.split() for line in head.decode("ascii", "replace").splitlines())
    fields = {words[0]: words[1:] for words in lines if words}
    wanted = ["x", "y", "z", "intensity"]
    points = fields.get("POINTS", [""])[0]
    if not (found and fields.get("FIELDS") == wanted and fields.get("SIZE") == ["4"] * 4):
        raise DataError(f"{path}: no binary PCD of float32 x y z intensity")
    if not points.isdecimal():
        raise DataError(f"{path}: the PCD header does not say how many POINTS there are")
    count = int(points)
    if len(body) < 16 * count:
        raise DataError(f"{path}: ends after {len(body) // 16} of {count} points; fetch it again")
    return _split(np.frombuffer(body, dtype="<f4", count=4 * count))


def _split(rows: NDArray[np.float32]) -> Points:
    table = rows.reshape(-1, 4)
    return np.ascontiguousarray(table[:, :3]), np.ascontiguousarray(table[:, 3])


def read_poses(path: Path) -> Matrix:
    """KITTI's format: the upper 3x4 of a pose per line."""
    lines = _bytes(path).decode("utf-8", "replace").splitlines()
    try:
        rows = np.array([line.split() for line in lines if line.strip()], dtype=np.float64)
        rows = rows.reshape(len(rows), 12)
    except ValueError:
        raise DataError(f"{path}: every line needs the 12 numbers of a pose") from None
    return matrices(rows)


def matrices(rows: NDArray[np.float64]) -> Matrix:
    """(n, 12) as (n, 4, 4)."""
    matrices = np.tile(np.eye(4), (rows.size // 12, 1, 1))
    matrices[:, :3] = rows.reshape(-1, 3, 4)
    return matrices


def read_calib_txt(path: Path, key: str) -> NDArray[np.float64]:
    """The twelve numbers of a line ``key: ...`` of calib.txt."""
    for line in _bytes(path).decode("utf-8", "replace").splitlines():
        name, _, numbers = line.partition(":")
        if name.strip() == key:
            try:
                return np.array(numbers.split(), dtype=np.float64).reshape(12)
            except ValueError:
                break
    raise DataError(f"{path}: has no line '{key}:' with 12 numbers")


def read_json(path: Path) -> Any:
    """The content of a JSON file."""
    try:
        return json.loads(_bytes(path))
    except ValueError as error:
        raise DataError(f"{path}: is not JSON ({error})") from error


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from None
