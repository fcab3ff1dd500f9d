"""After a training: the bias of each class, so that rare ones are said as often as serves the IoU.

Rare classes are drawn and weighed up while a network learns, or it would not learn them; at the end
it sees them too often. What is added to their logits is searched on the training's own data.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from tools.train.deeplab import DeepLab
from tools.train.pyramid_segmenter import PyramidSegmenter
from tools.train.salsanext import SalsaNext
from tools.train.segmentation_loss import IGNORED

#: What is tried on each class in turn, logits; how often around; on so many cells.
CHANGES, ROUNDS, CELLS = (-2.0, -1.0, -0.5, 0.5, 1.0), 2, 120_000
#: A class counts from this share of the cells on.
MIN_SHARE = 1e-4


def balance(
    network: nn.Module,
    inputs: Sequence[NDArray[np.float32]],
    classes: Sequence[NDArray[np.uint8]],
) -> None:
    """Change the biases of the network's scores: inputs (channels, height, width) and the classes
    (rows, columns) of its cells."""
    with torch.no_grad():
        logits = [network(torch.from_numpy(one[None]))[0].flatten(1).T.numpy() for one in inputs]
    said, truth = np.concatenate(logits), np.concatenate([one.ravel() for one in classes])
    known = np.flatnonzero(truth != IGNORED)
    chosen = np.random.default_rng(0).permutation(known)[:CELLS]
    bias = class_biases(said[chosen], truth[chosen])
    assert isinstance(network, DeepLab | PyramidSegmenter | SalsaNext)
    assert network.scores.bias is not None
    network.scores.bias.data += torch.from_numpy(bias)


def class_biases(logits: NDArray[np.float32], truth: NDArray[np.uint8]) -> NDArray[np.float32]:
    """What to add to the logits (n, classes) so that their greatest has the best mean IoU with the
    truth (n,): a coordinate search."""
    classes = logits.shape[1]
    count = np.bincount(truth, minlength=classes)
    present = np.flatnonzero(count >= max(1.0, MIN_SHARE * len(truth)))
    bias = np.zeros(classes, np.float32)
    best = _mean_iou(logits, truth, present)
    for _ in range(ROUNDS):
        for label in present:
            for change in CHANGES:
                tried = bias.copy()
                tried[label] += change
                score = _mean_iou(logits + tried, truth, present)
                if score > best:
                    best, bias = score, tried
    return bias


def _mean_iou(
    logits: NDArray[np.float32], truth: NDArray[np.uint8], present: NDArray[np.int64]
) -> float:
    classes = logits.shape[1]
    pairs = truth.astype(np.int64) * classes + logits.argmax(axis=1)
    counts = np.bincount(pairs, minlength=classes**2).reshape(classes, classes)
    hits = counts.diagonal()
    union = counts.sum(axis=0) + counts.sum(axis=1) - hits
    return float((hits[present] / union[present]).mean())
