"""PLY files as other programs write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import DataError
from stages.ply_file import read_ply

HEAD = "ply\nformat {}\ncomment voxel_m 0.5\nelement vertex 2\n"
PLACE = "property float x\nproperty double y\nproperty float32 z\nproperty uchar Class\n"
FACES = "element face 1\nproperty list uchar int vertex_indices\n"
ROWS = [(1.5, 2.0, -3.0, 13), (0.0, 0.0, 0.0, 255)]


def written(tmp_path: Path, form: str, body: bytes, head: str = HEAD + PLACE + FACES) -> Path:
    path = tmp_path / "map.ply"
    path.write_bytes((head.format(form) + "end_header\n").encode() + body)
    return path


@pytest.mark.parametrize("form", ["ascii 1.0", "binary_little_endian 1.0", "binary_big_endian 1.0"])
def test_vertices_before_faces_are_read_in_every_format(tmp_path: Path, form: str) -> None:
    order = ">" if "big" in form else "<"
    kind = [("x", order + "f4"), ("y", order + "f8"), ("z", order + "f4"), ("c", "u1")]
    body = np.array(ROWS, kind).tobytes() + b"\x03abc"
    if form.startswith("ascii"):
        body = b"".join(b"%g %g %g %d\n" % row for row in ROWS) + b"3 0 1 1\n"
    ply = read_ply(written(tmp_path, form, body))
    assert ply.points().tolist() == [list(row[:3]) for row in ROWS]
    labels = ply.column("label", "class")
    assert labels is not None
    assert labels.tolist() == [13, 255]
    assert ply.column("label") is None
    assert ply.comments == ("voxel_m 0.5",)


@pytest.mark.parametrize(
    ("head", "body", "what"),
    [
        ("obj\n", b"", "is no PLY file"),
        (HEAD + "property float x\nproperty float y\n", b"", "no x, y and z"),
        (HEAD + PLACE + "property list uchar int n\n", b"", "lists or unknown types"),
        ("ply\nformat {}\n" + FACES, b"", "first element is no vertex"),
        (HEAD + PLACE, b"123", "cannot be read"),
    ],
)
def test_a_file_that_cannot_be_read_is_named(
    tmp_path: Path, head: str, body: bytes, what: str
) -> None:
    path = written(tmp_path, "binary_little_endian 1.0", body, head)
    with pytest.raises(DataError, match=f"map.ply.*{what}"):
        read_ply(path)
    with pytest.raises(DataError, match=r"lines are missing|cannot be read"):
        read_ply(written(tmp_path, "ascii 1.0", b"1 2\n"))
    with pytest.raises(DataError, match=r"none\.ply: cannot be read"):
        read_ply(tmp_path / "none.ply")
