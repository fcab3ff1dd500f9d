"""What the image fusion says: the semantic mask of a camera image, and how it came about."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag, auto

import numpy as np
from numpy.typing import NDArray


class FusionStatus(IntFlag):
    """What a fused image had to do without; 0 is "everything was there"."""

    NO_DEPTH = auto()  #: no depth: nothing smoothed, boxes whole, boxes of other cameras left out
    NO_POSE = auto()  #: the poses do not cover the image's stamp: nothing smoothed
    FIRST_IMAGE = auto()  #: no image before it
    GAP = auto()  #: the image before it is too old: the past was dropped
    SIZE_CHANGED = auto()  #: the image before it had another size: the past was dropped
    SPOILED_SCORES = auto()  #: NaN or infinite scores were taken as "says nothing"
    UNCOVERED = auto()  #: pixels that no tile of the scores covers are uniform
    SPOILED_BOXES = auto()  #: boxes with a NaN, of no size or outside the image were left out
    BOXES_LEFT_OUT = auto()  #: another camera's boxes could not be carried over


@dataclass(frozen=True, slots=True, eq=False)
class FusedImage:
    """The fused semantics of one camera image (eq 6, 7)."""

    mask: NDArray[np.uint8]  #: (height, width) likeliest class, ids of the taxonomy
    confidence: NDArray[np.float32]  #: (height, width) its probability
    probabilities: (
        NDArray[np.float32] | None
    )  #: (classes, height, width), each pixel sums to 1; where the stage was asked for them
    camera: str
    status: FusionStatus
    smoothed: float  #: share of the pixels that took something from the image before, 0..1
