"""Training crops of labeled pictures: zoomed, flipped and re-lit, around objects of any class."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from tools.train.pictures import LabeledPicture

#: Of an object cut off by the crop's edge so much must be left to count as one.
MIN_VISIBLE = 0.35


@dataclass(frozen=True, slots=True)
class Augmentation:
    """How far crops may differ from the images they are cut from."""

    zoom: tuple[float, float] = (0.6, 2.4)  #: log-uniform; flights are lower and higher than these
    around_object: float = 0.8  #: share of crops around an object, its class drawn first
    flip: float = 0.5
    upside_down: float = 0.3
    quarter_turn: float = 0.25  #: seen from above, nothing has a right way up
    contrast: tuple[float, float] = (0.7, 1.35)
    gamma: tuple[float, float] = (0.75, 1.35)
    brightness: float = 35.0  #: counts of 255, either way
    noise: float = 6.0  #: largest standard deviation, counts


@dataclass(frozen=True, slots=True, eq=False)
class Crop:
    """A square cut of an image, and the objects in it."""

    pixels: NDArray[np.uint8]  #: (side, side, channels)
    boxes: NDArray[np.float32]  #: (n, 4) x0 y0 x1 y1, pixels of the crop
    classes: NDArray[np.int64]  #: (n,) index of the trained class, -1: no loss there


class Crops:
    """Draws crops of pictures with as many channels each.

    `labels` are the trained classes as ids of the taxonomy; objects of others are background.
    `odds` is how often a crop is made around each class.
    """

    def __init__(
        self,
        pictures: Sequence[LabeledPicture],
        labels: Sequence[int],
        odds: Sequence[float],
        *,
        side: int = 256,
        augmentation: Augmentation | None = None,
    ) -> None:
        self._pixels = [picture.pixels for picture in pictures]
        self._boxes = [picture.boxes for picture in pictures]
        self._classes = [_trained(picture.classes, labels) for picture in pictures]
        self._side = side
        self._how = augmentation or Augmentation()
        self._places = [self._of_class(label) for label in range(len(labels))]
        present = np.array([bool(len(places)) for places in self._places])
        if not present.any():
            raise DataError(
                "no image of the training data shows an object of a class to be trained"
            )
        weights = np.asarray(odds, dtype=np.float64) * present
        self._odds = weights / weights.sum()

    def _of_class(self, label: int) -> NDArray[np.int64]:
        """(n, 2) image and box of every object of the class."""
        pairs = [
            (number, box)
            for number, classes in enumerate(self._classes)
            for box in np.flatnonzero(classes == label)
        ]
        return np.array(pairs, dtype=np.int64).reshape(-1, 2)

    def draw(self, random: np.random.Generator) -> Crop:
        """One crop; the same generator state gives the same crop."""
        how = self._how
        center: NDArray[np.float32] | None = None
        if random.random() < how.around_object:
            places = self._places[random.choice(len(self._places), p=self._odds)]
            number, box = places[random.integers(len(places))]
            corners = self._boxes[number][box]
            center = (corners[:2] + corners[2:]) / 2
        else:
            number = random.integers(len(self._pixels))
        pixels = self._pixels[number]
        height, width = pixels.shape[:2]
        zoom = np.exp(random.uniform(*np.log(how.zoom)))
        cut = int(min(round(self._side / zoom), height, width))
        room = np.array([width - cut, height - cut])
        if center is None:
            corner = random.uniform(0, room + 1)
        else:
            corner = center - cut * random.uniform(0.1, 0.9, 2)
        x, y = np.clip(corner, 0, room).astype(int)
        scale = self._side / cut
        area = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        cropped = cv2.resize(
            pixels[y : y + cut, x : x + cut], (self._side, self._side), interpolation=area
        )
        boxes, classes = self._visible(number, np.array([x, y]), scale)
        if random.random() < how.flip:
            cropped = cropped[:, ::-1]
            boxes[:, [0, 2]] = self._side - boxes[:, [2, 0]]
        if random.random() < how.upside_down:
            cropped = cropped[::-1]
            boxes[:, [1, 3]] = self._side - boxes[:, [3, 1]]
        if random.random() < how.quarter_turn:
            cropped = cropped.swapaxes(0, 1)
            boxes = boxes[:, [1, 0, 3, 2]]
        lit = relit(cropped, how, random)
        return Crop(lit.reshape(self._side, self._side, -1), boxes, classes)

    def _visible(
        self, number: int, corner: NDArray[np.int64], scale: float
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """The boxes inside the crop, cut at its edge; classes -1 where too little is left."""
        whole = (self._boxes[number] - np.tile(corner, 2)) * scale
        boxes = np.clip(whole, 0, self._side)
        sides, full = boxes[:, 2:] - boxes[:, :2], whole[:, 2:] - whole[:, :2]
        inside = (sides > 1).all(axis=1)
        share = sides.prod(axis=1) / np.maximum(full.prod(axis=1), 1e-6)
        classes = np.where(share >= MIN_VISIBLE, self._classes[number], -1)
        keep = inside & (self._classes[number] > -2)
        return boxes[keep].astype(np.float32), classes[keep]


def relit(
    pixels: NDArray[np.uint8], how: Augmentation, random: np.random.Generator
) -> NDArray[np.uint8]:
    """Another gain, gamma and level of the whole image, and noise: another night or camera."""
    level = np.arange(256) / 255.0
    level = level ** np.exp(random.uniform(*np.log(how.gamma)))
    level = (level - 0.5) * np.exp(random.uniform(*np.log(how.contrast))) + 0.5
    level = level * 255 + random.uniform(-how.brightness, how.brightness)
    lit = np.clip(level, 0, 255).astype(np.float32)[pixels]
    spread = random.uniform(0, how.noise)
    lit += np.float32(spread) * random.standard_normal(lit.shape, dtype=np.float32)
    return np.asarray(np.clip(lit, 0, 255), dtype=np.uint8)


def _trained(classes: NDArray[np.int64], labels: Sequence[int]) -> NDArray[np.int64]:
    """Index of the trained class; -1 to be ignored, -2 of no interest."""
    trained = np.where(classes < 0, -1, -2)
    for index, label in enumerate(labels):
        trained[classes == label] = index
    return trained
