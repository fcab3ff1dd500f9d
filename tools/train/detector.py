"""The task of learning to detect: crops of annotated images for a CenterNet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from tools.train.center_loss import center_loss
from tools.train.center_net import CenterNet
from tools.train.center_targets import center_targets
from tools.train.crops import Crop, Crops

#: What pixels are brought to: -1..1.
MEAN = STD = 127.5


def as_input(crops: Sequence[Crop]) -> Tensor:
    """(n, channels, side, side) of the crops' pixels."""
    pixels = np.stack([crop.pixels for crop in crops])
    return (torch.from_numpy(pixels).permute(0, 3, 1, 2).float() - MEAN) / STD


class Detector:
    """Batches of crops and the loss of a CenterNet."""

    def __init__(
        self, network: CenterNet, crops: Crops, classes: int, batch_size: int = 16
    ) -> None:
        self.network = network
        self._crops = crops
        self._classes = classes
        self._batch_size = batch_size

    def batch(self, random: np.random.Generator) -> dict[str, Tensor]:
        crops = [self._crops.draw(random) for _ in range(self._batch_size)]
        targets = [center_targets(crop, self._classes) for crop in crops]
        return {
            "input": as_input(crops),
            "heat": torch.from_numpy(np.stack([one.heat for one in targets])),
            "counted": torch.from_numpy(np.stack([one.counted for one in targets])),
            "boxes": torch.from_numpy(np.stack([one.boxes for one in targets])),
            "weight": torch.from_numpy(np.stack([one.weight for one in targets])),
        }

    def loss(self, outputs: Mapping[str, Tensor], batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return center_loss(outputs, batch)
