"""Fig 18: how far off persons and vehicles are found by day, in color and in thermal images."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from pipeline.message import Message
from stages.kernels.average_precision import assigned
from stages.labels import Labels
from stages.simulation.simulation import Simulation
from stages.simulation.specification import load_preset
from stages.simulation.truth import visible_things
from stages.simulation.whereabouts import Whereabouts
from stages.sinks.whole_file import whole_file
from stages.taxonomy import load_taxonomy
from stages.types import Detections, Image
from tools.annotated_flights import as_drawn
from tools.drawing.plot import Line, line_plot
from tools.tables.detectors import RGB, THERMAL, Detector, alike, images_of, with_boxes
from tools.tables.experiment import Experiment
from tools.tables.map_pictures import write_picture
from tools.train.flights import messages_of

FLIGHT = "disaster"
CAMERAS = (RGB, THERMAL)
CLASSES = ("person", "vehicle")
EDGES_M = (0.0, 10.0, 20.0, 30.0, 45.0, 70.0, 110.0)
#: Of a box and the object that it finds: small boxes are off by a pixel or two.
MIN_IOU = 0.4


@dataclass(frozen=True, slots=True)
class Found:
    """An object that both cameras show at an instant, and which of them found it."""

    stamp: int
    label: int
    distance_m: float
    by: frozenset[str]


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """One camera at one instant."""

    image: Message[Image]
    found: Detections
    objects: dict[int, NDArray[np.float32]]  #: box by thing
    classes: dict[int, int]  #: class by thing
    things: NDArray[np.int64]  #: (n,) the thing that each detection found, -1: none


def draw_daylight(experiment: Experiment, folder: Path) -> list[Path]:
    """The instant at which the thermal camera finds the farthest person that the color camera
    misses, in both images; recall over distance as a table and a plot. Raises OverflightError,
    Interrupted."""
    world, detectors = experiment.world, alike(experiment)
    (flight,) = world.flights(FLIGHT)
    simulation = Simulation(*load_preset(str(world.preset_of(FLIGHT))))
    places = Whereabouts(simulation.district)
    path = simulation.district.flight
    found: list[Found] = []
    given = {camera: np.zeros(2, dtype=np.int64) for camera in CAMERAS}
    best: tuple[tuple[float, int], tuple[Seen, Seen], NDArray[np.float64]] | None = None
    for pair in seen_by_both(flight, detectors):
        stamp = pair[0].image.stamp
        here = path.at(np.array([stamp]))[0, :3, 3]
        distance_m = np.linalg.norm(places.at(stamp) - here, axis=1)
        now = compared(pair, distance_m)
        found += now
        for camera, seen in zip(CAMERAS, pair, strict=True):
            given[camera][0] += len(seen.things)
            given[camera][1] += int(np.count_nonzero(seen.things >= 0))
        worth = told_by(now)
        if best is None or worth > best[0]:
            best = worth, pair, distance_m
    if best is None:
        raise DataError(f"{flight}: has no color and thermal images of the same instants")
    written = [write_picture(folder / "figure-18.png", beside(best[1], best[2]))]
    for ending, text in (("md", table_of(found, given)), ("svg", plot_of(found))):
        with whole_file(folder / f"figure-18.{ending}") as file:
            file.write(text.encode())
        written.append(folder / f"figure-18.{ending}")
    return written


def seen_by_both(flight: Path, detectors: Mapping[str, Detector]) -> Iterator[tuple[Seen, Seen]]:
    """Color and thermal images of the same instants, with what is true of them and what the
    detectors say. Raises OverflightError."""
    truths = {
        camera: {one.stamp: one.payload for one in messages_of(flight, f"truth/{camera}")}
        for camera in CAMERAS
    }
    thermal = {image.stamp: image for image in images_of(flight, THERMAL)}
    for image in images_of(flight, RGB):
        other = thermal.get(image.stamp)
        if other is None:
            continue
        seen = []
        for camera, taken in zip(CAMERAS, (image, other), strict=True):
            truth = truths[camera].get(taken.stamp)
            if not isinstance(truth, Labels):
                raise DataError(f"{flight}: says nothing true of {camera} at {taken.stamp}")
            seen.append(judged(taken, detectors[camera].boxes(taken).payload, truth))
        yield seen[0], seen[1]


def judged(image: Message[Image], found: Detections, truth: Labels) -> Seen:
    """Which object of its class each detection finds, best first."""
    boxes, things = visible_things(truth)
    drawn, _ = as_drawn(boxes)
    order = np.argsort(-found.scores, kind="stable")
    hit = np.full(len(order), -1, dtype=np.int64)
    for label in (load_taxonomy().id(name) for name in CLASSES):
        mine, theirs = boxes.classes == label, found.classes[order] == label
        which = assigned(found.boxes[order][theirs], drawn[mine], MIN_IOU)
        hit[np.flatnonzero(theirs)] = np.where(which >= 0, things[mine][which], -1)
    by_thing = np.full(len(order), -1, dtype=np.int64)
    by_thing[order] = hit
    return Seen(
        image,
        found,
        {int(thing): box for thing, box in zip(things, drawn, strict=True)},
        {int(thing): int(label) for thing, label in zip(things, boxes.classes, strict=True)},
        by_thing,
    )


def compared(pair: tuple[Seen, Seen], distance_m: NDArray[np.float64]) -> list[Found]:
    """The persons and vehicles that both cameras show, by how far they are (things,)."""
    wanted = {load_taxonomy().id(name) for name in CLASSES}
    both = pair[0].objects.keys() & pair[1].objects.keys()
    return [
        Found(
            pair[0].image.stamp,
            pair[0].classes[thing],
            float(distance_m[thing]),
            frozenset(
                camera for camera, seen in zip(CAMERAS, pair, strict=True) if thing in seen.things
            ),
        )
        for thing in sorted(both)
        if pair[0].classes[thing] in wanted
    ]


def told_by(now: Sequence[Found]) -> tuple[float, int]:
    """How much an instant shows: the farthest person that the thermal camera alone finds, m, and
    how many objects are found at all."""
    person = load_taxonomy().id("person")
    alone = [one.distance_m for one in now if one.by == {THERMAL} and one.label == person]
    return max(alone, default=0.0), sum(bool(one.by) for one in now)


def recall_over_distance(
    found: Sequence[Found], name: str
) -> list[tuple[float, float, int, dict[str, float]]]:
    """(from, to, objects, recall by camera and of `either`) of the bins that hold objects."""
    label, rows = load_taxonomy().id(name), []
    for low, high in pairwise(EDGES_M):
        mine = [one for one in found if one.label == label and low <= one.distance_m < high]
        if mine:
            shares = {
                camera: sum(camera in one.by for one in mine) / len(mine) for camera in CAMERAS
            }
            shares["either"] = sum(bool(one.by) for one in mine) / len(mine)
            rows.append((low, high, len(mine), shares))
    return rows


def table_of(found: Sequence[Found], given: dict[str, NDArray[np.int64]]) -> str:
    """Recall in percent over distance, and how much of what was found is there, as Markdown."""
    lines = ["| | m | objects | color | thermal | either |", "|---|---|---|---|---|---|"]
    for name in CLASSES:
        for low, high, count, shares in recall_over_distance(found, name):
            cells = " | ".join(f"{100 * shares[c]:.0f}" for c in (*CAMERAS, "either"))
            lines.append(f"| {name} | {low:.0f} to {high:.0f} | {count} | {cells} |")
    told = ", ".join(
        f"{camera} {100 * right / total:.0f} % of {total}" if total else f"{camera} nothing"
        for camera, (total, right) in given.items()
    )
    words = (
        "Recall in % of the objects that both cameras show at the same instant (24 pixels or more "
        f"in each); a box finds one with an IoU of {MIN_IOU}. Boxes that are right: {told}. Both "
        "networks learned the same way from one simulated flight by day in clear air."
    )
    return "\n".join([*lines, "", words]) + "\n"


def plot_of(found: Sequence[Found]) -> str:
    """Recall over distance, as SVG."""
    lines = [
        Line(
            f"{name}, {camera}",
            [
                ((low + high) / 2, 100 * shares[camera])
                for low, high, _, shares in recall_over_distance(found, name)
            ],
            color,
            camera == RGB,
        )
        for color, name in enumerate(CLASSES)
        for camera in CAMERAS
    ]
    return line_plot(lines, "distance, m", "recall, %")


def beside(pair: tuple[Seen, Seen], distance_m: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Color left and thermal right, of one height; each box says how far off its object is."""
    pictures = []
    for seen in pair:
        texts = [
            f"{distance_m[thing]:.0f} m" if thing >= 0 else "wrong"
            for thing in seen.things.tolist()
        ]
        pictures.append(with_boxes(seen.image.payload, seen.found, texts))
    height = min(len(picture) for picture in pictures)
    return np.concatenate([_of_height(picture, height) for picture in pictures], axis=1)


def _of_height(picture: NDArray[np.uint8], height: int) -> NDArray[np.uint8]:
    width = round(picture.shape[1] * height / picture.shape[0])
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
