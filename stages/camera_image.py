"""What a network stage takes of a camera: 8-bit pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import StageError
from stages.types import Image


def eight_bit(image: Image) -> NDArray[np.uint8]:
    """The pixels of an 8-bit image, uncopied. Raises StageError for a 16-bit or empty one."""
    if not image.data.size:
        raise StageError(f"camera '{image.camera}' gives an image without pixels")
    if image.data.dtype != np.uint8:
        raise StageError(
            f"camera '{image.camera}' gives {image.data.dtype} images, networks take uint8; "
            "switch its gain control on or convert the images first"
        )
    return np.asarray(image.data, dtype=np.uint8)
