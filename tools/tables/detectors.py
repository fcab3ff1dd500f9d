"""The shipped detectors on the images of a simulated flight, as `graphs/uav/networks.yaml` runs
them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from accelerators.registry import Registry
from pipeline.message import Message
from pipeline.model import BoundModel
from stages.camera_image import eight_bit
from stages.detect import DetectObjects
from stages.kernels.render import draw_box
from stages.taxonomy import load_taxonomy
from stages.thermal_agc import ThermalAgc
from stages.types import Detections, Image
from tools.evaluate_detections import open_model
from tools.train.flights import messages_of

#: From this score on a box counts, by network: the graph's. The thermal detector was trained on
#: real images and takes simulated windows for vehicles.
MIN_SCORES = {"detect-rgb": 0.4, "detect-thermal": 0.6}
RGB, THERMAL = "rgb", "thermal"


@dataclass(frozen=True, slots=True)
class Detector:
    """A network and its least score."""

    name: str
    model: BoundModel

    @classmethod
    def open(cls, name: str) -> Self:
        """The shipped file. Raises OverflightError."""
        bound, _ = open_model(Registry.open(), name, None)
        return cls(name, bound)

    def boxes(self, image: Message[Image]) -> Message[Detections]:
        """What it finds in an image."""
        stage = DetectObjects(min_score=MIN_SCORES[self.name])
        return Message.at(image.stamp, stage.run_once(image, model=self.model))


def images_of(flight: Path, topic: str) -> Iterator[Message[Image]]:
    """The images of a camera; thermal ones with the gain that the graphs give them."""
    gain = ThermalAgc(mode="clahe")
    for message in messages_of(flight, topic):
        yield Message.at(message.stamp, gain.process(message)) if topic == THERMAL else message


def with_boxes(
    image: Image, found: Detections, texts: list[str] | None = None
) -> NDArray[np.uint8]:
    """RGB with the boxes in the colors of their classes, each with a text, else class and score."""
    taxonomy = load_taxonomy()
    pixels: NDArray[Any] = eight_bit(image)
    color = pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)
    picture = np.ascontiguousarray(color).copy()
    for number in range(len(found.boxes)):
        name = taxonomy.names[int(found.classes[number])]
        text = f"{name} {found.scores[number]:.2f}" if texts is None else texts[number]
        draw_box(picture, found.boxes[number], text, taxonomy.colors[int(found.classes[number])])
    return picture
