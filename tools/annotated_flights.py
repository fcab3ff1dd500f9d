"""The images of simulated flights with the boxes that are true of them, to judge a detector by."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from pipeline.message import Message
from stages.taxonomy import load_taxonomy
from stages.thermal_agc import ThermalAgc
from stages.types import Detections, Image
from tools.annotated_images import AnnotatedImage
from tools.train.flights import with_truth

#: Persons to some, part of a bicycle to others: nobody is judged by them.
IN_BETWEEN = "rider"


def read_flight(flight: Path, channels: int) -> list[AnnotatedImage]:
    """The color (3 channels) or thermal (1) images of a flight, or of a folder of flights.

    Thermal images of 16 bit are brought to 8 as the graphs do. Raises DataError without any.
    """
    found = list(_images(flight, channels))
    if not found:
        kind = "color" if channels == 3 else "thermal"
        raise DataError(f"{flight}: holds no {kind} images with boxes")
    return found


def as_drawn(truth: Detections) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Boxes and classes as people would draw them, riders as regions to be ignored.

    The truth goes from an object's first pixel to its last; a drawn box, like a detector's, goes
    around both, which is one pixel more.
    """
    boxes = truth.boxes + np.array([0, 0, 1, 1], dtype=np.float32)
    return boxes, np.where(truth.classes == load_taxonomy().id(IN_BETWEEN), -1, truth.classes)


def _images(flight: Path, channels: int) -> Iterator[AnnotatedImage]:
    gains: dict[str, ThermalAgc] = {}
    for number, (image, truth) in enumerate(with_truth(flight, Image, Detections, "/boxes")):
        if (image.data.ndim == 3) != (channels == 3):
            continue
        gain = gains.setdefault(image.camera, ThermalAgc(mode="clahe"))
        pixels: NDArray[Any] = gain.process(Message.at(0, image)).data
        boxes, classes = as_drawn(truth)
        yield AnnotatedImage(
            path=flight / f"{image.camera}_{number:05d}.png",
            size=(pixels.shape[1], pixels.shape[0]),
            boxes=boxes,
            classes=classes,
            pixels=np.asarray(pixels, dtype=np.uint8),
        )
