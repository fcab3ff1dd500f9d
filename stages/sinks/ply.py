"""Binary PLY files of the map or of clouds, in class colors: they open in CloudCompare, MeshLab,
Open3D and Blender."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.message import Message
from pipeline.stage import Stage
from stages.kernels.compiled import as_input
from stages.kernels.probability import read_out
from stages.ply_file import VOXEL_COMMENT
from stages.sinks.last_map import LastMap
from stages.sinks.whole_file import whole_file
from stages.taxonomy import Taxonomy, load_taxonomy
from stages.types import Cloud, SemanticVoxels

#: One vertex: position (m), class color, class id, probability of that class, entropy (nats).
VERTEX = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("class", "u1"),
        ("confidence", "<f4"),
        ("entropy", "<f4"),
    ]
)
PLY_TYPES = {"<f4": "float", "|u1": "uchar"}


class WritePly(LastMap):
    """Writes the last map it got to `path` when it closes."""

    def write(self, path: Path, voxels: SemanticVoxels) -> None:
        vertices = vertices_of(voxels.positions, voxels.log_scores, load_taxonomy())
        write_ply(path, vertices, "map frame, meters", f"{VOXEL_COMMENT} {voxels.voxel_m:g}")


class WriteCloudPly(Stage):
    """Writes each cloud it gets, in its sensor's frame, to `folder`/`<stamp in ns>`.ply."""

    def __init__(self, *, folder: Path, unlabeled: bool = False) -> None:
        """`unlabeled`: also write the points without evidence, as background."""
        self._folder = Path(folder)
        self._unlabeled = unlabeled

    def process(self, cloud: Message[Cloud]) -> None:
        payload = cloud.payload
        kept = payload.evidence
        if self._unlabeled:
            has_return = np.isfinite(payload.points).all(axis=1) & payload.points.any(axis=1)
            kept = kept | has_return
        said = np.where(payload.evidence[kept, None], payload.log_scores[kept], np.float32(0))
        vertices = vertices_of(payload.points[kept], said, load_taxonomy())
        path = self._folder / f"{cloud.stamp:020d}.ply"
        write_ply(path, vertices, f"frame of {payload.sensor}, meters")


def vertices_of(
    positions: NDArray[np.float32], log_scores: NDArray[np.float32], taxonomy: Taxonomy
) -> NDArray[np.void]:
    """(n,) `VERTEX` of positions (n, 3) and log scores (n, 16)."""
    label, confidence, entropy = read_out(as_input(log_scores), len(taxonomy))
    vertices = np.empty(len(positions), dtype=VERTEX)
    for axis, name in enumerate(("x", "y", "z")):
        vertices[name] = positions[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        vertices[name] = taxonomy.colors[label, channel]
    vertices["class"], vertices["confidence"] = label, confidence
    vertices["entropy"] = entropy
    return vertices


def write_ply(path: Path, vertices: NDArray[np.void], *comments: str) -> None:
    """Write `VERTEX` rows as binary little-endian PLY, whole or not at all. Raises DataError."""
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    lines.append(f"element vertex {len(vertices)}")
    for name in VERTEX.names or ():
        lines.append(f"property {PLY_TYPES[VERTEX[name].str]} {name}")
    lines.append("end_header\n")
    with whole_file(path) as file:
        file.write("\n".join(lines).encode("ascii"))
        file.write(vertices.tobytes())
