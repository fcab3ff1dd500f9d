"""What every training of a scan network shares: its image, its rate, what its files say."""

from __future__ import annotations

from tools.train.plan import Order
from tools.train.products import Meaning

#: Rows and columns of the range image.
SIZE = (64, 512)
#: Greatest learning rate: twice that of the image networks, as a scan network has few parameters.
RATE = 4e-3


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
