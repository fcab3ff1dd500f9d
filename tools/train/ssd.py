"""The single-shot detector with anchors (SSD), on the backbones and pyramid of the CenterNet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from stages.kernels.anchors import CODER, SMALL_OBJECTS, multiscale_anchors
from tools.train.blocks import ConvBn
from tools.train.center_net import PRIOR
from tools.train.crops import Crop, Crops
from tools.train.detector import as_input
from tools.train.pyramid import Backbone, Pyramid

#: Boxes at each cell of a level.
FORMS = len(SMALL_OBJECTS.ratios) * SMALL_OBJECTS.per_octave
#: From which overlap an anchor learns an object, and up to which it learns that there is none.
MATCHED, UNMATCHED = 0.5, 0.4
#: Focal loss of Lin et al. (RetinaNet); a box is worth as much as its class.
ALPHA, GAMMA = 0.25, 2.0


class Ssd(nn.Module):
    """`boxes` (n, anchors, 4) ty tx th tw and `scores` (n, anchors, classes) logits of an image."""

    output_names = ("boxes", "scores")

    def __init__(self, backbone: Backbone, classes: int, neck: int = 32, head: int = 48) -> None:
        super().__init__()
        self._classes = classes
        self.backbone = backbone
        self.pyramid = Pyramid(backbone.widths, neck)
        self.head = nn.ModuleList(ConvBn(neck, head) for _ in backbone.widths)
        self.scores = nn.ModuleList(nn.Conv2d(head, FORMS * classes, 1) for _ in backbone.widths)
        self.boxes = nn.ModuleList(nn.Conv2d(head, FORMS * 4, 1) for _ in backbone.widths)
        for predictor in (*self.scores, *self.boxes):
            nn.init.normal_(predictor.weight, std=0.01)
            nn.init.zeros_(predictor.bias)
        for predictor in self.scores:
            nn.init.constant_(predictor.bias, float(torch.logit(torch.tensor(PRIOR))))

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        levels = self.pyramid(self.backbone(image))
        heads = [head(level) for head, level in zip(self.head, levels, strict=True)]
        return {
            "boxes": _rows([one(x) for one, x in zip(self.boxes, heads, strict=True)], 4),
            "scores": _rows(
                [one(x) for one, x in zip(self.scores, heads, strict=True)], self._classes
            ),
        }

    def registry_head(self) -> Mapping[str, Any]:
        """What the registry says of the outputs."""
        anchors = SMALL_OBJECTS._asdict() | {
            "kind": "multiscale",
            "levels": list(SMALL_OBJECTS.levels),
            "ratios": list(SMALL_OBJECTS.ratios),
        }
        return {"kind": "ssd", "anchors": anchors, "background": False}


def _rows(maps: list[Tensor], width: int) -> Tensor:
    """One row per anchor, in the order of level, row, column, form."""
    return torch.cat([one.permute(0, 2, 3, 1).reshape(len(one), -1, width) for one in maps], dim=1)


class SsdDetector:
    """Batches of crops and the loss of an SSD."""

    def __init__(self, network: Ssd, crops: Crops, side: int = 256, batch_size: int = 16) -> None:
        self.network = network
        self._crops = crops
        self._batch_size = batch_size
        self._anchors = multiscale_anchors(*SMALL_OBJECTS, (side, side)) * side

    def batch(self, random: np.random.Generator) -> dict[str, Tensor]:
        crops = [self._crops.draw(random) for _ in range(self._batch_size)]
        matched = [match_anchors(crop, self._anchors) for crop in crops]
        return {
            "input": as_input(crops),
            "labels": torch.from_numpy(np.stack([labels for labels, _ in matched])),
            "boxes": torch.from_numpy(np.stack([boxes for _, boxes in matched])),
        }

    def loss(self, outputs: Mapping[str, Tensor], batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        labels = batch["labels"]
        logits = outputs["scores"].float()
        matched = labels >= 0
        count = matched.sum().clamp(min=1)
        wanted = functional.one_hot(labels.clamp(min=0), logits.shape[2]).float()
        wanted *= matched[..., None]
        probability = logits.sigmoid()
        right = torch.where(wanted > 0, probability, 1 - probability)
        weight = torch.where(wanted > 0, ALPHA, 1 - ALPHA) * (1 - right) ** GAMMA
        cross = functional.binary_cross_entropy_with_logits(logits, wanted, reduction="none")
        scores = (weight * cross)[labels > -2].sum() / count
        regressed = outputs["boxes"].float()[matched]
        boxes = functional.smooth_l1_loss(regressed, batch["boxes"][matched], reduction="sum")
        return {"scores": scores, "boxes": boxes / count}


def match_anchors(
    crop: Crop, anchors: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """What each anchor (n, 4) y x height width, in pixels, is to say of a crop.

    Labels (n,): the class, -1 for nothing, -2 for no matter. Regressions (n, 4) ty tx th tw. Each
    object has at least the anchor that overlaps it most.
    """
    labels = np.full(len(anchors), -1, dtype=np.int64)
    regressions = np.zeros((len(anchors), 4), np.float32)
    if not len(crop.boxes):
        return labels, regressions
    overlap = _iou(anchors, crop.boxes)
    owner, best = overlap.argmax(axis=1), overlap.max(axis=1)
    favorite = overlap.argmax(axis=0)
    owner[favorite] = np.arange(len(crop.boxes))
    labels[best >= UNMATCHED] = -2
    taken = best >= MATCHED
    taken[favorite] = True
    labels[taken] = np.where(crop.classes[owner[taken]] < 0, -2, crop.classes[owner[taken]])
    hidden = crop.boxes[crop.classes < 0]
    for x0, y0, x1, y1 in hidden:
        y, x = anchors[:, 0], anchors[:, 1]
        labels[(labels == -1) & (x > x0) & (x < x1) & (y > y0) & (y < y1)] = -2
    box, anchor = crop.boxes[owner], anchors
    size = box[:, [3, 2]] - box[:, [1, 0]]
    center = (box[:, [3, 2]] + box[:, [1, 0]]) / 2
    regressions[:, :2] = (center - anchor[:, :2]) / anchor[:, 2:] * CODER[:2]
    regressions[:, 2:] = np.log(np.maximum(size, 1) / anchor[:, 2:]) * CODER[2:]
    return labels, regressions


def _iou(anchors: NDArray[np.float32], boxes: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, m) overlap of anchors y x height width and boxes x0 y0 x1 y1."""
    low = anchors[:, [1, 0]] - anchors[:, [3, 2]] / 2
    high = anchors[:, [1, 0]] + anchors[:, [3, 2]] / 2
    sides = np.minimum(high[:, None], boxes[None, :, 2:]) - np.maximum(
        low[:, None], boxes[None, :, :2]
    )
    shared = np.clip(sides, 0, None).prod(axis=2)
    areas = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
    union = anchors[:, 2:].prod(axis=1)[:, None] + areas[None] - shared
    return np.asarray(shared / union, dtype=np.float32)
