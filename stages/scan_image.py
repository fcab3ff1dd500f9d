"""A LiDAR scan as the range image that a network sees: which point is in which cell (eq 18)."""

from __future__ import annotations

import logging
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import as_input
from stages.kernels.range_image import fill_channels, organized_cells, project_scan, ranges
from stages.types import Scan

log = logging.getLogger(__name__)

NO_REMISSION = as_input(np.zeros(0, dtype=np.float32))

#: An organized scan is taken as it is where this share of its points, as far away as this (nearer
#: ones show where the beams start), lie within so many cells of where eq 18 puts them. Ouster's OS0
#: in its own field of view: 0.99; an OS1 in that of an OS0: 0.15.
FITTING_SHARE = 0.75
FITTING_CELLS = 2
FAR_M = 4.0
FAR_POINTS = 100

#: The point of each cell (rows, columns), the cell of each point (n,), both -1 where none, and the
#: point's range (n,) m, 0 where it has no return.
Places: TypeAlias = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]


class RangeImage:
    """How scans become images of `size` (rows, columns).

    An organized scan whose rows and columns are a whole multiple of the image's is taken row by row
    and column by column, unless `organized` is False. Any other is projected; so is, with a
    warning, one that looks elsewhere than the image: with another field of view, or a first column
    that is not straight behind. A projected point out of `elevation_rad` is in no cell. What lies
    beyond `max_range_m` counts as no return.
    """

    def __init__(
        self,
        size: tuple[int, int],
        elevation_rad: tuple[float, float],
        max_range_m: float = np.inf,
        *,
        organized: bool = True,
    ) -> None:
        self.size = size
        self._elevation_rad = elevation_rad
        self._max_range_m = max_range_m
        self._organized = organized
        self._cells: dict[tuple[int, int], tuple[NDArray[np.int32], NDArray[np.int32]]] = {}
        self._fits: dict[tuple[int, int], bool] = {}  #: by shape, once a scan could tell

    def places(self, scan: Scan) -> Places:
        """Where each point of the scan is in the image."""
        own = self._own_cells(scan)
        points = as_input(scan.points)
        if own is None:
            return project_scan(points, self.size, self._elevation_rad, self._max_range_m)
        distance = ranges(points)
        if self._max_range_m < np.inf:
            distance[distance > self._max_range_m] = 0.0
        return *own, distance

    def channels(
        self, scan: Scan, mean: NDArray[np.float32], std: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """(4 or 5, rows, columns) range, x, y, z and remission, each as (value - mean) / std; 0
        without a return. `mean` and `std` are (4,) or (5,)."""
        nearest = (self._own_cells(scan) or self.places(scan))[0]
        filled: NDArray[np.float32] = fill_channels(
            as_input(scan.points),
            NO_REMISSION if scan.remission is None else as_input(scan.remission),
            as_input(nearest),
            as_input(mean),
            as_input(std),
            self._max_range_m,
        )
        return filled

    def _own_cells(self, scan: Scan) -> tuple[NDArray[np.int32], NDArray[np.int32]] | None:
        """The cells of a scan that is taken as it is; None of one that is projected."""
        shape = scan.shape
        if not self._organized or shape is None:
            return None
        if shape[0] % self.size[0] or shape[1] % self.size[1]:
            return None
        if shape not in self._cells:
            self._cells[shape] = organized_cells(shape, self.size)
        if shape not in self._fits:
            self._judge(scan, shape)
        return self._cells[shape] if self._fits.get(shape, True) else None

    def _judge(self, scan: Scan, shape: tuple[int, int]) -> None:
        """Whether the scan looks where the image does, unless it has too little to tell."""
        _, placed, distance = project_scan(
            as_input(scan.points), self.size, self._elevation_rad, self._max_range_m
        )
        far = distance > FAR_M
        if np.count_nonzero(far) < FAR_POINTS:
            return
        columns = self.size[1]
        own, placed = self._cells[shape][1][far], placed[far]
        rows_off = abs(placed // columns - own // columns)
        columns_off = abs((placed - own + columns // 2) % columns - columns // 2)
        near = (placed >= 0) & (rows_off <= FITTING_CELLS) & (columns_off <= FITTING_CELLS)
        share = float(near.mean())
        self._fits[shape] = share >= FITTING_SHARE
        if not self._fits[shape]:
            log.warning(
                "scans of %d x %d from '%s' look elsewhere than the image of the network (%.0f %% "
                "of their points are where it has them): they are projected",
                *shape,
                scan.sensor,
                100 * share,
            )
