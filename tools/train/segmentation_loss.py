"""The losses of the segmentation networks: weighted cross entropy and Lovasz-softmax."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

#: The class without truth: it teaches nothing.
IGNORED = 0
#: Smaller errors of a probability are left out of the Lovasz loss, which this changes by no more:
#: most are, and sorting them all took a sixth of a training step.
SMALLEST_ERROR = 0.005


def class_weights(counts: Sequence[int], power: float = 1.0, floor: float = 0.001) -> Tensor:
    """(classes,) 1 / (share + floor) to a power; 0 for the class without truth and for classes that
    never occur. SalsaNext weighs with power 1 and floor 0.001."""
    count = torch.tensor(counts, dtype=torch.float64)
    count[IGNORED] = 0
    weights = (count / count.sum().clamp(min=1) + floor) ** -power
    return torch.where(count > 0, weights, 0.0).float()


def cross_entropy(logits: Tensor, labels: Tensor, weights: Tensor) -> Tensor:
    """The weighted mean over all cells of `logits` (n, classes, h, w) with a truth (n, h, w)."""
    counted = weights[labels].sum().clamp(min=1e-6)
    each = functional.cross_entropy(logits, labels, weights, reduction="sum", ignore_index=IGNORED)
    return each / counted


def lovasz_softmax(logits: Tensor, labels: Tensor) -> Tensor:
    """The Lovasz extension of 1 - IoU (Berman et al., CVPR 2018), the mean over classes present.

    Cells of all images count together, as the IoU of an evaluation does.
    """
    classes = logits.shape[1]
    known = labels.flatten() != IGNORED
    probability = logits.softmax(dim=1).movedim(1, -1).reshape(-1, classes)[known]
    truth = labels.flatten()[known]
    losses = []
    for label in truth.unique():
        is_it = (truth == label).to(probability.dtype)
        error = (is_it - probability[:, label]).abs()
        counted = error > SMALLEST_ERROR
        error, order = error[counted].sort(descending=True)
        losses.append((error * lovasz_gradient(is_it[counted][order], is_it.sum())).sum())
    return torch.stack(losses).mean() if losses else logits.sum() * 0


def lovasz_gradient(truth: Tensor, objects: Tensor) -> Tensor:
    """(n,) how much 1 - IoU grows with each further error, truth (n,) 0 or 1 by falling error, of
    a class that `objects` cells are of."""
    shared = objects - truth.cumsum(0)
    union = objects + (1 - truth).cumsum(0)
    loss = 1 - shared / union
    return torch.cat((loss[:1], loss[1:] - loss[:-1]))
