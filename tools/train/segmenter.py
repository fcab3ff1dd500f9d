"""The tasks of learning to segment: crops of images for a DeepLab, range images for a SalsaNext."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from stages.types import CHANNELS
from tools.train.crops import relit
from tools.train.deeplab import DeepLab
from tools.train.detector import MEAN, STD
from tools.train.pyramid_segmenter import PyramidSegmenter
from tools.train.recipes import AHEAD
from tools.train.salsanext import SalsaNext
from tools.train.segmentation_loss import IGNORED, class_weights, cross_entropy, lovasz_softmax

#: Share of the crops that are cut around a cell of a class, the class drawn first, the rarer the
#: likelier (1 / share to this power): persons and bicycles are some thousandths of all cells.
AROUND_CLASS, ODDS_POWER = 0.7, 0.5
#: Of the published class weights (1 / share) the square root: with crops around rare classes, the
#: whole makes a network see persons everywhere.
WEIGHT_POWER = 0.5
#: What is added to the shares in both: else riders, a fortieth of the persons, take a third of the
#: draws, and persons are called riders.
SHARE_FLOOR = 0.01
#: An image holds a class from so many cells on.
MIN_CELLS = 12


@dataclass(frozen=True, slots=True, eq=False)
class LabeledImage:
    """An image and the class of each pixel."""

    pixels: NDArray[np.uint8]  #: (height, width, 3) RGB
    classes: NDArray[np.uint8]  #: (height, width) ids of the taxonomy, 0 without truth


@dataclass(frozen=True, slots=True, eq=False)
class LabeledScan:
    """A range image and the class of each cell."""

    channels: NDArray[np.float32]  #: (5, rows, columns) range, x, y, z in m, remission 0..1
    classes: NDArray[np.uint8]  #: (rows, columns) ids of the taxonomy, 0 without a return


class ImageSegmenter:
    """Batches of crops and the loss of a network whose corners are aligned: `side` is a multiple
    of 32, plus one."""

    def __init__(
        self,
        network: DeepLab | PyramidSegmenter,
        images: Sequence[LabeledImage],
        stride: int,
        side: int = 257,
        batch_size: int = 6,
    ) -> None:
        self.network = network
        self._images = images
        self._stride = stride
        self._side = side
        self._batch_size = batch_size
        self._places = _Places([one.classes for one in images])
        self._weights = class_weights(self._places.counts, WEIGHT_POWER, SHARE_FLOOR)

    def batch(self, random: np.random.Generator) -> dict[str, Tensor]:
        crops = [self._crop(random) for _ in range(self._batch_size)]
        pixels = np.stack([pixels for pixels, _ in crops]).astype(np.float32)
        # Corners are aligned, so the cells lie on every fourth (eighth, ...) pixel.
        classes = np.stack([one[:: self._stride, :: self._stride] for _, one in crops])
        return {
            "input": (torch.from_numpy(pixels).permute(0, 3, 1, 2) - MEAN) / STD,
            "classes": torch.from_numpy(classes.astype(np.int64)),
        }

    def loss(self, outputs: Tensor, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return segmentation_loss(outputs.float(), batch["classes"], self._weights)

    def _crop(self, random: np.random.Generator) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        number, around = self._places.draw(random)
        image = self._images[number]
        height, width = image.classes.shape
        zoom = np.exp(random.uniform(*np.log(AHEAD.zoom)))
        cut = int(min(round(self._side / zoom), height, width))
        room = np.array([height - cut, width - cut])
        corner = random.integers(room + 1)
        if around is not None:
            corner = np.clip(around - (cut * random.uniform(0.1, 0.9, 2)).astype(int), 0, room)
        y, x = corner
        size = (self._side, self._side)
        pixels = cv2.resize(image.pixels[y : y + cut, x : x + cut], size)
        classes = cv2.resize(
            image.classes[y : y + cut, x : x + cut], size, interpolation=cv2.INTER_NEAREST
        )
        if random.random() < AHEAD.flip:
            pixels, classes = pixels[:, ::-1], classes[:, ::-1]
        return relit(pixels, AHEAD, random), classes


class ScanSegmenter:
    """Batches of range images, turned, mirrored and with lost returns; the loss of a SalsaNext."""

    def __init__(
        self,
        network: SalsaNext,
        scans: Sequence[LabeledScan],
        mean: NDArray[np.float32],
        std: NDArray[np.float32],
        columns: int = 160,
        batch_size: int = 6,
        lost: float = 0.5,
    ) -> None:
        """`mean` and `std` (5,) are those of the stage that will prepare the scans.

        A batch holds so many `columns` of each: a part of a turn takes a part of the time, and more
        places make a better batch. Half of them lose up to a share of `lost` of their returns.
        """
        self.network = network
        self._scans = scans
        self._mean = mean[:, None, None]
        self._std = std[:, None, None]
        self._columns = columns
        self._lost = lost
        self._batch_size = batch_size
        self._places = _Places([one.classes for one in scans])
        self._weights = class_weights(self._places.counts, WEIGHT_POWER, SHARE_FLOOR)

    def batch(self, random: np.random.Generator) -> dict[str, Tensor]:
        drawn = [self._draw(random) for _ in range(self._batch_size)]
        return {
            "input": torch.from_numpy(np.stack([channels for channels, _ in drawn])),
            "classes": torch.from_numpy(np.stack([classes for _, classes in drawn])),
        }

    def loss(self, outputs: Tensor, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return segmentation_loss(outputs.float(), batch["classes"], self._weights)

    def _draw(self, random: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        number, around = self._places.draw(random)
        scan = self._scans[number]
        columns = int(random.integers(scan.classes.shape[1]))
        if around is not None:
            columns = int(random.integers(self._columns)) - int(around[1])
        turned = turned_scan(scan, columns, self._columns)
        if random.random() < 0.5:
            turned = mirrored_scan(turned)
        share = random.uniform(0, self._lost) * (random.random() < 0.5)
        gone = random.random(turned.classes.shape) < share
        here = (turned.channels[0] > 0) & ~gone
        channels = np.where(here, (turned.channels - self._mean) / self._std, 0)
        return channels.astype(np.float32), np.where(here, turned.classes, 0).astype(np.int64)

    def as_input(self, scan: LabeledScan) -> NDArray[np.float32]:
        """A scan as the network gets it, unchanged."""
        here = scan.channels[0] > 0
        normal = np.where(here, (scan.channels - self._mean) / self._std, 0)
        return np.asarray(normal, dtype=np.float32)


def turned_scan(scan: LabeledScan, columns: int, kept: int | None = None) -> LabeledScan:
    """The scan of a sensor turned about its z axis: columns further right, points further clockwise
    (the azimuth falls from column to column, eq 18). All of its columns, or the first `kept`."""
    around = scan.classes.shape[1]
    angle = -2 * np.pi * columns / around
    chosen = (np.arange(kept or around) - columns) % around
    channels = scan.channels[:, :, chosen]
    x, y = channels[1].copy(), channels[2].copy()
    channels[1] = np.cos(angle) * x - np.sin(angle) * y
    channels[2] = np.sin(angle) * x + np.cos(angle) * y
    return LabeledScan(channels, scan.classes[:, chosen])


def mirrored_scan(scan: LabeledScan) -> LabeledScan:
    """The scan of the mirrored world: left is right."""
    channels = scan.channels[:, :, ::-1].copy()
    channels[2] *= -1
    return LabeledScan(channels, scan.classes[:, ::-1])


def segmentation_loss(logits: Tensor, classes: Tensor, weights: Tensor) -> dict[str, Tensor]:
    """Cross entropy for every cell, Lovasz for the IoU that it will be judged by."""
    return {
        "entropy": cross_entropy(logits, classes, weights),
        "lovasz": lovasz_softmax(logits, classes),
    }


class _Places:
    """Where in labeled images (rows, columns) which class is, to draw rare ones often."""

    def __init__(self, images: Sequence[NDArray[np.uint8]]) -> None:
        self._images = images
        cells = np.stack(
            [np.bincount(one.ravel(), minlength=CHANNELS)[:CHANNELS] for one in images]
        )
        self.counts = [int(count) for count in cells.sum(axis=0)]  #: cells of each class
        cells[:, IGNORED] = 0
        self._holders = {
            label: np.flatnonzero(cells[:, label] >= MIN_CELLS)
            for label in np.flatnonzero((cells >= MIN_CELLS).any(axis=0))
        }
        odds = class_weights(self.counts, ODDS_POWER, SHARE_FLOOR).numpy().astype(np.float64)
        self._odds = odds[list(self._holders)] / max(odds[list(self._holders)].sum(), 1e-9)

    def draw(self, random: np.random.Generator) -> tuple[int, NDArray[np.int64] | None]:
        """The number of an image and, in a share of the draws, a cell (row, column) of a class."""
        if not self._holders or random.random() >= AROUND_CLASS:
            return int(random.integers(len(self._images))), None
        label = random.choice(list(self._holders), p=self._odds)
        number = int(random.choice(self._holders[label]))
        cells = np.flatnonzero(self._images[number] == label)
        cell = cells[random.integers(len(cells))]
        return number, np.array(np.unravel_index(cell, self._images[number].shape))
