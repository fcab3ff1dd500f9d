"""The loss of a CenterNet: focal on the heat, generalized IoU on the boxes."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor
from torch.nn import functional

#: A box is worth so much of a bump.
BOX_WEIGHT = 2.0


def center_loss(outputs: Mapping[str, Tensor], targets: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """`heat` and `box` of a batch, per object; their sum is to be minimized."""
    objects = targets["heat"].eq(1).sum().clamp(min=1)
    heat = heat_loss(outputs["heat"].float(), targets["heat"], targets["counted"])
    boxes = decoded(outputs["size"].float(), outputs["offset"].float())
    weight = targets["weight"][:, 0]
    overlap = generalized_iou(boxes, targets["boxes"])
    box = ((1 - overlap) * weight)[weight > 0].sum()
    return {"heat": heat / objects, "box": BOX_WEIGHT * box / objects}


def heat_loss(logits: Tensor, heat: Tensor, counted: Tensor) -> Tensor:
    """The focal loss of Law and Deng (CornerNet, eq 1) with alpha 2 and beta 4, summed."""
    probability = logits.sigmoid()
    hit = (1 - probability) ** 2 * functional.logsigmoid(logits)
    miss = (1 - heat) ** 4 * probability**2 * functional.logsigmoid(-logits)
    return -(torch.where(heat.eq(1), hit, miss) * counted).sum()


def decoded(size: Tensor, offset: Tensor) -> Tensor:
    """Boxes (n, 4, h, w) x0 y0 x1 y1 in cells of what the network says at every cell."""
    rows, columns = size.shape[2:]
    x = torch.arange(columns, device=size.device) + 0.5 + offset[:, 0]
    y = torch.arange(rows, device=size.device)[:, None] + 0.5 + offset[:, 1]
    half_width, half_height = (size.clamp(-4, 6).exp() / 2).unbind(dim=1)
    return torch.stack((x - half_width, y - half_height, x + half_width, y + half_height), dim=1)


def generalized_iou(one: Tensor, other: Tensor) -> Tensor:
    """GIoU (Rezatofighi et al., CVPR 2019) of boxes (n, 4, ...) x0 y0 x1 y1: -1..1."""
    ax0, ay0, ax1, ay1 = one.unbind(dim=1)
    bx0, by0, bx1, by1 = other.unbind(dim=1)
    shared_width = (torch.minimum(ax1, bx1) - torch.maximum(ax0, bx0)).clamp(min=0)
    shared_height = (torch.minimum(ay1, by1) - torch.maximum(ay0, by0)).clamp(min=0)
    shared = shared_width * shared_height
    union = (ax1 - ax0) * (ay1 - ay0) + (bx1 - bx0) * (by1 - by0) - shared
    hull_width = torch.maximum(ax1, bx1) - torch.minimum(ax0, bx0)
    hull = hull_width * (torch.maximum(ay1, by1) - torch.minimum(ay0, by0))
    return shared / union.clamp(min=1e-6) - (hull - union) / hull.clamp(min=1e-6)
