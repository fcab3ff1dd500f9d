"""A picture of the map from above."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stages.kernels.render import add_legend, encode_png, top_view
from stages.sinks.drawn_map import DrawnMap, in_colors, legend
from stages.sinks.whole_file import whole_file
from stages.types import SemanticVoxels

LONGEST_SIDE = 1800  #: pixels that a picture fills at least half of


class TopView(DrawnMap):
    """Draws the last map it got to `path` (PNG) when it closes.

    The highest voxel of each column in its class color, a legend of the classes present and a scale
    bar. The ground is paled, so that cars stand out on the road, whose color is almost theirs;
    background and sky are left out.
    """

    def write(self, path: Path, voxels: SemanticVoxels) -> None:
        with whole_file(path) as file:
            file.write(encode_png(draw_map(voxels)))


def draw_map(voxels: SemanticVoxels) -> NDArray[np.uint8]:
    """The map from above as an RGB image (height, width, 3)."""
    kept, label, colors = in_colors(voxels)
    positions = voxels.positions[kept]
    extent = np.ptp(positions[:, :2], axis=0).max() if len(positions) else 0.0
    cells = int(extent / voxels.voxel_m) + 1
    cell_pixels = max(1, min(8, LONGEST_SIDE // cells))
    picture = top_view(positions, label, colors, voxels.voxel_m, cell_pixels)
    return add_legend(picture, legend(label, colors), cell_pixels / voxels.voxel_m)
