"""Point clouds out of PLY files, whoever wrote them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError

#: numpy's type by PLY's names for it.
TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
#: The first word of the comment that says how large the voxels of a map are, m.
VOXEL_COMMENT = "voxel_m"

ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}


@dataclass(frozen=True, slots=True, eq=False)
class Ply:
    """The vertices of a file and what its comments say."""

    vertices: NDArray[np.void]  #: (n,) one field per property
    comments: tuple[str, ...]

    def points(self) -> NDArray[np.float64]:
        """(n, 3) x y z."""
        return np.stack([self.vertices[axis].astype(np.float64) for axis in "xyz"], axis=1)

    def column(self, *names: str) -> NDArray[np.generic] | None:
        """The property with one of these names, whatever its case; None where there is none."""
        for name in self.vertices.dtype.names or ():
            if name.lower() in names:
                return np.asarray(self.vertices[name])
        return None


def read_ply(path: Path) -> Ply:
    """Read the vertices of an ascii or binary PLY file; faces after them are left alone.

    Raises DataError naming the file for anything else.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from None
    head, found, body = content.partition(b"end_header")
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    if not found or not lines or lines[0] != ["ply"]:
        raise DataError(f"{path}: is no PLY file")
    body = body[body.find(b"\n") + 1 :]
    order = next((ORDERS.get(words[1]) for words in lines if words[:1] == ["format"]), None)
    elements = [words for words in lines if words[:1] == ["element"]]
    if order is None or not elements or elements[0][1] != "vertex" or len(elements[0]) != 3:
        raise DataError(f"{path}: a PLY file whose first element is no vertex of a known format")
    after = lines.index(elements[1]) if len(elements) > 1 else len(lines)
    properties = [words[1:] for words in lines[:after] if words[:1] == ["property"]]
    if any(len(words) != 2 or words[0] not in TYPES for words in properties):
        raise DataError(f"{path}: a vertex with lists or unknown types; write plain numbers")
    kind = np.dtype([(name, order + TYPES[type_]) for type_, name in properties])
    if not {"x", "y", "z"} <= set(kind.names or ()):
        raise DataError(f"{path}: its vertices have no x, y and z")
    comments = tuple(" ".join(words[1:]) for words in lines if words[:1] == ["comment"])
    try:
        count = int(elements[0][2])
        if order == "=":
            rows = body.decode("ascii", "replace").splitlines()[:count]
            numbers = np.array([row.split()[: len(properties)] for row in rows], dtype=np.float64)
            if numbers.shape != (count, len(properties)) and count:
                raise ValueError("lines are missing")
            vertices = np.empty(count, dtype=kind)
            for column, name in enumerate(kind.names or ()):
                vertices[name] = numbers[:, column] if count else 0
        else:
            vertices = np.frombuffer(body, dtype=kind, count=count)
    except ValueError as error:
        raise DataError(f"{path}: its vertices cannot be read ({error}); fetch it again") from None
    return Ply(vertices, comments)
