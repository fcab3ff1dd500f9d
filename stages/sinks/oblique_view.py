"""A picture of the map from above and aside, in which walls stand up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stages.kernels.render import add_legend, encode_png, oblique_view
from stages.sinks.drawn_map import DrawnMap, in_colors, legend
from stages.sinks.whole_file import whole_file
from stages.types import SemanticVoxels

#: The outermost voxels on each side are left out: single returns from far away, which would make
#: the rest small.
OUTERMOST = 0.005


class ObliqueView(DrawnMap):
    """Draws the last map it got to `path` (PNG) when it closes: each voxel a cube, with a legend.

    In the colors of `TopView`; seen from where x and y are low.
    """

    def write(self, path: Path, voxels: SemanticVoxels) -> None:
        with whole_file(path) as file:
            file.write(encode_png(draw_map_aside(voxels)))


def draw_map_aside(voxels: SemanticVoxels) -> NDArray[np.uint8]:
    """The map from aside as an RGB image (height, width, 3)."""
    kept, label, colors = in_colors(voxels)
    indices = voxels.indices[kept]
    if len(indices):
        low, high = np.quantile(indices[:, :2], [OUTERMOST, 1 - OUTERMOST], axis=0)
        within = ((indices[:, :2] >= low) & (indices[:, :2] <= high)).all(axis=1)
        indices, label = indices[within], label[within]
    return add_legend(oblique_view(indices, label, colors), legend(label, colors))
