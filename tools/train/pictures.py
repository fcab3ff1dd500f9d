"""The pictures that a detector is trained on, from annotated folders and recorded flights."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from pipeline.message import Message
from stages.thermal_agc import ThermalAgc
from stages.types import Detections, Image
from tools.annotated_flights import as_drawn
from tools.annotated_images import AnnotatedImage, read_annotated
from tools.train.flights import with_truth


@dataclass(frozen=True, slots=True, eq=False)
class LabeledPicture:
    """One picture and what is to be seen in it."""

    pixels: NDArray[np.uint8]  #: (height, width) gray or (height, width, 3) RGB
    boxes: NDArray[np.float32]  #: (n, 4) x0 y0 x1 y1, pixels
    classes: NDArray[np.int64]  #: (n,) ids of the taxonomy, -1 for a region to be ignored


def read_pictures(data: Path, channels: int) -> list[LabeledPicture]:
    """All pictures of an annotated folder, or of the cameras of flights with ground truth (an .mcap
    file, or a folder of them).

    Of a flight those count that are in color (3 channels) or gray (1) of themselves; thermal images
    of 16 bit get the gain that the graphs give them.

    800 thermal frames take 262 MB. Raises DataError naming the file and what is wrong with it.
    """
    if data.suffix == ".mcap" or any(data.glob("*.mcap")):
        return list(_of_flight(data, channels))
    found = [_of_image(image) for image in read_annotated(data)]
    return [
        LabeledPicture(in_channels(one.pixels, channels), one.boxes, one.classes) for one in found
    ]


def in_channels(pixels: NDArray[np.uint8], channels: int) -> NDArray[np.uint8]:
    """The picture as gray (1 channel) or RGB (3)."""
    if channels == 1 and pixels.ndim == 3:
        return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    if channels == 3 and pixels.ndim == 2:
        return np.repeat(pixels[..., None], 3, axis=2)
    return pixels


def _of_image(image: AnnotatedImage) -> LabeledPicture:
    pixels = image.read()
    if pixels.dtype != np.uint8:
        raise DataError(f"{image.path}: has {pixels.dtype} pixels; train on 8-bit images")
    if (pixels.shape[1], pixels.shape[0]) != image.size:
        raise DataError(
            f"{image.path}: is {pixels.shape[1]}x{pixels.shape[0]}, its annotations say "
            f"{image.size[0]}x{image.size[1]}"
        )
    return LabeledPicture(np.asarray(pixels, dtype=np.uint8), image.boxes, image.classes)


def _of_flight(flight: Path, channels: int) -> Iterator[LabeledPicture]:
    gains: dict[str, ThermalAgc] = {}
    for image, truth in with_truth(flight, Image, Detections, "/boxes"):
        if (image.data.ndim == 3) != (channels == 3):
            continue
        gain = gains.setdefault(image.camera, ThermalAgc(mode="clahe"))
        pixels = gain.process(Message.at(0, image)).data
        yield LabeledPicture(np.asarray(pixels, dtype=np.uint8), *as_drawn(truth))
