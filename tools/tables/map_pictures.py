"""Maps of a flight as pictures that can be held beside each other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stages.kernels.render import add_legend, encode_png, oblique_view
from stages.sinks.whole_file import whole_file
from stages.taxonomy import load_taxonomy
from stages.types import SemanticVoxels
from stages.voxel_map import VoxelMap
from tools.tables.evidence import fused_evidence
from tools.tables.scan_judging import ScanNetwork
from tools.tables.world import VOXEL_M, World


def map_of(
    world: World, flight: str, network: ScanNetwork | None, *, cameras: bool
) -> SemanticVoxels:
    """The map of a flight, of the network's evidence (None: it has none) and of the cameras'."""
    built = VoxelMap(voxel_m=VOXEL_M, classes=len(load_taxonomy()))
    for scan in world.judged(flight):
        observation = scan.observation
        if observation.map_from_sensor is None:
            continue
        cloud = fused_evidence(observation, network, cameras=cameras)
        built.integrate(cloud, observation.map_from_sensor, observation.stamp)
    return built.snapshot()


def from_aside(
    indices: NDArray[np.int32],
    labels: NDArray[np.uint8],
    frame: NDArray[np.int32] | None = None,
    elevation_deg: float = 50.0,
) -> NDArray[np.uint8]:
    """Voxels (n, 3) of labels (n,) from aside, with the legend of what is there; pictures of one
    `frame` (k, 3) of voxels show the same part of the world."""
    colors = load_taxonomy().colors
    return add_legend(
        oblique_view(indices, labels, colors, elevation_deg, frame), legend_of(labels)
    )


def legend_of(labels: NDArray[np.uint8]) -> Sequence[tuple[str, Sequence[int]]]:
    """Name and color of the classes that occur."""
    taxonomy = load_taxonomy()
    present = np.unique(labels).tolist()
    return [(taxonomy.names[k], taxonomy.colors[k].tolist()) for k in present if k]


def write_picture(path: Path, picture: NDArray[np.uint8]) -> Path:
    """As PNG; the path."""
    with whole_file(path) as file:
        file.write(encode_png(picture))
    return path
