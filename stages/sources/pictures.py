"""Read a picture file as the array that `Image` holds."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError

#: What OpenCV reads and cameras write.
SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


def read_picture(path: Path) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """(height, width, 3) RGB uint8, or (height, width) gray uint8 or uint16. Raises DataError."""
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise DataError(f"{path}: is no picture that can be read; fetch it again or take it out")
    if picture.ndim == 2 and picture.dtype in (np.uint8, np.uint16):
        return np.asarray(picture)
    if picture.ndim == 3 and picture.dtype == np.uint8:
        code = cv2.COLOR_BGRA2RGB if picture.shape[2] == 4 else cv2.COLOR_BGR2RGB
        return np.asarray(cv2.cvtColor(picture, code), dtype=np.uint8)
    raise DataError(
        f"{path}: has {picture.dtype} pixels of shape {picture.shape}; "
        "8-bit color and 8- or 16-bit gray can be used"
    )
