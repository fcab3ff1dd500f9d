"""Fig 17: a disaster site, unlike all that was learned, seen with the networks as they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelerators.registry import Registry
from pipeline.errors import DataError
from pipeline.message import Message
from stages.draw_fused import drawn
from stages.fuse_image import FuseImage
from stages.kernels.probability import read_out
from stages.kernels.render import add_legend
from stages.segment_image import SegmentImage
from stages.sources.recording import calibration
from stages.taxonomy import load_taxonomy
from stages.types import Image
from tools.evaluate_detections import open_model
from tools.propagation.pictures import range_panels
from tools.tables.detectors import RGB, THERMAL, Detector, images_of, with_boxes
from tools.tables.evidence import classes_of, fused_evidence
from tools.tables.map_pictures import from_aside, legend_of, map_of, write_picture
from tools.tables.networks import ADAPTED, Networks
from tools.tables.world import JudgedScan, World
from tools.train.flights import messages_of

FLIGHT = "disaster"


def draw_disaster(world: World, networks: Networks, folder: Path) -> list[Path]:
    """(a) RGB detections, (b) the fused image, (c) the scan of that moment before and after label
    propagation, (d) the map of the flight. Raises OverflightError, Interrupted."""
    (flight,) = world.flights(FLIGHT)
    before = networks.open("source", 0, 512, ADAPTED)
    after = networks.open("views-map", 0, 512, ADAPTED)
    scan = busiest(world)
    image = _at(flight, RGB, scan.observation.stamp)
    boxes = Detector.open("detect-rgb").boxes(image)
    fused = _fused(flight, image)
    labelings: dict[str, NDArray[np.uint8] | None] = {"true": scan.truth}
    for title, network, cameras in (
        ("before label propagation, fused", before, True),
        ("after label propagation, single", after, False),
        ("after label propagation, fused", after, True),
    ):
        cloud = fused_evidence(scan.observation, network, cameras=cameras)
        labelings[title] = classes_of(cloud).astype(np.uint8)
    voxels = map_of(world, FLIGHT, after, cameras=True)
    label, _, _ = read_out(voxels.log_scores, len(load_taxonomy()))
    pictures = {
        "a-detections": with_boxes(image.payload, boxes.payload),
        "b-fused-image": fused,
        "c-scan": range_panels(scan.observation, labelings),
        "d-map": from_aside(voxels.indices, label),
    }
    return [
        write_picture(folder / f"figure-17-{name}.png", picture)
        for name, picture in pictures.items()
    ]


def busiest(world: World) -> JudgedScan:
    """The scan of the flight with most persons in the cameras' view."""
    person = load_taxonomy().id("person")
    best: tuple[int, JudgedScan] | None = None
    for scan in world.judged(FLIGHT):
        count = len(np.unique(scan.things[(scan.truth == person) & scan.visible]))
        if best is None or count > best[0]:
            best = count, scan
    assert best is not None  # `judged` raises where there are no scans
    return best[1]


def _fused(flight: Path, image: Message[Image]) -> NDArray[np.uint8]:
    """The image with the classes of one fusion: segmentation, both detectors, depth; no past."""
    model, _ = open_model(Registry.open(), "segment-rgb", None)
    scores = Message.at(image.stamp, SegmentImage().run_once(image, model=model))
    thermal = _at(flight, THERMAL, image.stamp)
    depth = min(messages_of(flight, f"{RGB}/depth"), key=lambda one: abs(one.stamp - image.stamp))
    poses = tuple(messages_of(flight, "pose"))
    fuse = FuseImage(calibration=calibration(path=flight))
    fused = fuse.run_once(
        scores,
        Detector.open("detect-rgb").boxes(image),
        Detector.open("detect-thermal").boxes(thermal),
        depth,
        poses,
    )
    return add_legend(drawn(fused, image.payload, 0.5), legend_of(fused.mask))


def _at(flight: Path, topic: str, stamp: int) -> Message[Image]:
    """The image nearest to a stamp."""
    found = min(images_of(flight, topic), key=lambda one: abs(one.stamp - stamp), default=None)
    if found is None:
        raise DataError(f"{flight}: holds no images of {topic}")
    return found
