"""A picture of the map from above."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import as_input
from stages.kernels.probability import read_out
from stages.kernels.render import add_legend, encode_png, top_view
from stages.sinks.last_map import LastMap
from stages.sinks.whole_file import whole_file
from stages.taxonomy import load_taxonomy
from stages.types import SemanticVoxels

LONGEST_SIDE = 1800  #: pixels that a picture fills at least half of


class TopView(LastMap):
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
    taxonomy = load_taxonomy()
    label, _, _ = read_out(as_input(voxels.log_scores), len(taxonomy))
    shown = ~np.isin(label, [0, taxonomy.id("sky")])
    positions, label = voxels.positions[shown], label[shown]
    extent = np.ptp(positions[:, :2], axis=0).max() if len(positions) else 0.0
    cells = int(extent / voxels.voxel_m) + 1
    cell_pixels = max(1, min(8, LONGEST_SIDE // cells))
    paled = taxonomy.colors // 2 + 127
    colors = np.where(taxonomy.ground[:, None], paled, taxonomy.colors).astype(np.uint8)
    picture = top_view(positions, label, colors, voxels.voxel_m, cell_pixels)
    present = [(taxonomy.names[k], colors[k].tolist()) for k in np.unique(label)]
    return add_legend(picture, present, cell_pixels / voxels.voxel_m)
