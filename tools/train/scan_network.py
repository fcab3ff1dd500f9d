"""What every training of a scan network shares: its image, its rate, what its files say."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tools.train.plan import Order
from tools.train.products import Meaning

#: Rows and columns of the range image.
SIZE = (64, 512)
#: Greatest learning rate: twice that of the image networks, as a scan network has few parameters.
RATE = 4e-3
#: The 8-bit file has one scale for all channels of its input. What is farther from the mean than so
#: many deviations it takes as that far; the rest is told the more finely.
SATURATED = 3.0


def meaning_of_scans(description: str, order: Order) -> Meaning:
    """What a network says of range images, which reach it normalized."""
    return Meaning(
        description=description,
        license=order.license,
        source=f"overflight train segment-scan; {order.attribution}",
        head={"kind": "scores", "align_corners": False},
        classes={},
        color=None,
        mean=0.0,
        std=1.0,
    )


def calibration(inputs: Sequence[NDArray[np.float32]]) -> list[NDArray[np.float32]]:
    """What tells the 8-bit file its ranges, of normalized inputs (channels, rows, columns)."""
    return [one.clip(-SATURATED, SATURATED) for one in inputs]
