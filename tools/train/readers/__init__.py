"""Readers of public data sets, one file per layout."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tools.train.readers import flights, paris_carla, pcl_segmentation, semantickitti
from tools.train.scan_sources import ScanSource


@dataclass(frozen=True, slots=True)
class Layout:
    """How labeled scans lie in a folder."""

    looks_like: str  #: in the words of an error
    fits: Callable[[Path], bool]
    open: Callable[[Path], ScanSource]


#: By the name that a mixture gives them; the first that fits is taken.
LAYOUTS = {
    "flights": Layout("*.mcap of 'overflight simulate'", flights.fits, flights.open_scans),
    "semantickitti": Layout(
        "velodyne/*.bin with labels/*.label, or sequences/NN of them",
        semantickitti.fits,
        semantickitti.open_scans,
    ),
    "paris-carla": Layout(
        "a street as *.ply with tags and times", paris_carla.fits, paris_carla.open_views
    ),
    "pcl-segmentation": Layout(
        "*.npy of (rows, columns, 6)", pcl_segmentation.fits, pcl_segmentation.open_scans
    ),
}
