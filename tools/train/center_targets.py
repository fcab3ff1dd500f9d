"""What a CenterNet is to say of a crop: a bump of heat per object, and its box around the bump."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tools.train.center_net import STRIDE
from tools.train.crops import Crop

#: Width of a bump: a share of the box's side, but never so narrow that it falls between cells.
SIGMA_SHARE, MIN_SIGMA_CELLS = 0.12, 0.55
#: Every cell above this heat learns the box, not the center alone: its peak may fall beside it.
BOX_HEAT = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class CenterTargets:
    """Maps at stride 4."""

    heat: NDArray[np.float32]  #: (classes, h, w) 0..1, 1 exactly in the center cell of an object
    counted: NDArray[np.float32]  #: (1, h, w) 0 where nothing is to be learned
    boxes: NDArray[np.float32]  #: (4, h, w) x0 y0 x1 y1 in cells, where `weight` is above 0
    weight: NDArray[np.float32]  #: (1, h, w), adds up to 1 for each object that is not hidden


def center_targets(crop: Crop, classes: int) -> CenterTargets:
    """The maps of one crop; of two objects in a cell the smaller has it."""
    side = crop.pixels.shape[0] // STRIDE
    heat = np.zeros((classes, side, side), np.float32)
    counted = np.ones((1, side, side), np.float32)
    boxes = np.zeros((4, side, side), np.float32)
    owner = np.full((side, side), -1)
    share = np.zeros((side, side), np.float32)
    cell = np.arange(side) + 0.5
    scaled = crop.boxes / STRIDE
    for number in np.argsort(-(scaled[:, 2:] - scaled[:, :2]).prod(axis=1)):
        x0, y0, x1, y1 = box = scaled[number]
        label = crop.classes[number]
        if label < 0:
            counted[0, int(y0) : int(np.ceil(y1)), int(x0) : int(np.ceil(x1))] = 0
            continue
        bumps = [
            np.exp(-0.5 * ((cell - (low + high) / 2) / _sigma(high - low)) ** 2)
            for low, high in ((y0, y1), (x0, x1))
        ]
        bump = np.outer(*bumps).astype(np.float32)
        bump[min(int((y0 + y1) / 2), side - 1), min(int((x0 + x1) / 2), side - 1)] = 1
        np.maximum(heat[label], bump, out=heat[label])
        near = bump > BOX_HEAT
        owner[near] = number
        share[near] = bump[near]
        boxes[:, near] = box[:, None]
    counted[0, heat.max(axis=0) == 1] = 1
    owned = owner >= 0
    total = np.bincount(owner[owned], share[owned], minlength=len(scaled) + 1)
    share[owned] /= total[owner[owned]]
    return CenterTargets(heat, counted, boxes, share[None])


def _sigma(side_cells: float) -> float:
    return max(MIN_SIGMA_CELLS, SIGMA_SHARE * side_cells)
