"""Detectors on the images of a simulated flight: those that ship, and a pair that is alike."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
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
from stages.sinks.whole_file import whole_file
from stages.taxonomy import load_taxonomy
from stages.thermal_agc import ThermalAgc
from stages.types import Detections, Image
from tools.evaluate_detections import open_model
from tools.tables.experiment import Experiment
from tools.train.flights import messages_of

#: From this score on a box counts, by network: the graph's. The thermal detector was trained on
#: real images and takes simulated windows for vehicles.
MIN_SCORES = {"detect-rgb": 0.4, "detect-thermal": 0.6}
RGB, THERMAL = "rgb", "thermal"
LEAST = 0.4  #: of the pair: what `stages.detect` takes by itself


@dataclass(frozen=True, slots=True)
class Detector:
    """A network and its least score."""

    model: BoundModel
    min_score: float

    @classmethod
    def open(cls, name: str) -> Self:
        """The shipped file, at the graph's least score. Raises OverflightError."""
        bound, _ = open_model(Registry.open(), name, None)
        return cls(bound, MIN_SCORES[name])

    def boxes(self, image: Message[Image]) -> Message[Detections]:
        """What it finds in an image."""
        stage = DetectObjects(min_score=self.min_score)
        return Message.at(image.stamp, stage.run_once(image, model=self.model))


def alike(experiment: Experiment) -> dict[str, Detector]:
    """By camera, a detector of color and one of thermal images that learned the same way: from as
    many images of the same flight, with one recipe. Raises OverflightError, Interrupted.

    Of the shipped ones the one learned from simulated flights and the other from real ones.
    """
    (flight,) = experiment.world.flights("lookout")
    return {camera: _trained(experiment, flight, camera) for camera in (RGB, THERMAL)}


def _trained(experiment: Experiment, flight: Path, camera: str) -> Detector:
    from tools.train.detect import train_detector
    from tools.train.plan import Order as Training
    from tools.train.recipes import DETECT_RGB, DETECT_THERMAL

    name = f"detect-{camera}"
    folder = experiment.world.folder / "networks" / name
    registry = folder / "models.yaml"
    if not (folder / "done").is_file():
        thermal = camera == THERMAL
        recipe = replace(
            DETECT_RGB,
            name=name,
            description=f"Persons, vehicles and bicycles in {camera} images of a simulated flight",
            size=DETECT_THERMAL.size if thermal else DETECT_RGB.size,
            channels=1 if thermal else 3,
        )
        training = Training(
            data=flight,
            output=folder,
            steps=experiment.steps,
            seed=0,
            threads=experiment.threads,
            license="Apache-2.0",
            attribution="a simulated flight of Overflight",
            command="overflight evaluate --figure 18",
            quantized=False,
        )
        experiment.console.print(f"training {name} ...", highlight=False)
        registry = train_detector(recipe, training, "residual", "centernet", experiment.console)
        with whole_file(folder / "done") as file:
            file.write(b"")
    bound, _ = open_model(Registry.open(registry), name, "openvino")
    return Detector(bound, LEAST)


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
