"""Ground truth as payloads: what every pixel, return and voxel really is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """Class and instance of every pixel of an image, or of every ray of an organized scan."""

    classes: NDArray[np.uint8]  #: (rows, columns) ids of the taxonomy; 0 where a ray has no return
    instances: NDArray[np.uint16]  #: (rows, columns) number of the object; 0 for none
    sensor: str  #: name in the calibration


@dataclass(frozen=True, slots=True, eq=False)
class LabeledVoxels:
    """The classes of the voxels that surfaces pass through, in the map frame."""

    voxel_m: float  #: edge length
    indices: NDArray[np.int32]  #: (n, 3) floor(position / voxel_m), no two the same
    classes: NDArray[np.uint8]  #: (n,) ids of the taxonomy
