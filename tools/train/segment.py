"""`overflight train segment-rgb` and `segment-scan`: flights with ground truth to networks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console

from pipeline.errors import DataError
from stages.kernels.compiled import as_input
from stages.labels import Labels
from stages.scan_image import RangeImage
from stages.scan_statistics import ScanStatistics
from stages.types import CHANNELS, Image, Scan
from tools.train.balance import balance
from tools.train.deeplab import DeepLab
from tools.train.detector import MEAN, STD
from tools.train.flights import with_truth
from tools.train.plan import Order, Plan, carry_out
from tools.train.products import SAMPLES, Meaning
from tools.train.pyramid_segmenter import PyramidSegmenter
from tools.train.readers import vistas
from tools.train.residual_backbone import ResidualBackbone
from tools.train.salsanext import SalsaNext
from tools.train.segmenter import ImageSegmenter, LabeledImage, LabeledScan, ScanSegmenter

#: Width and height of an image (848 x 480 and one, see DeepLab), columns and rows of a scan.
IMAGE_SIZE = (849, 481)
SCAN_SIZE = (512, 64)
#: Up to this share of the returns are taken away in training: the sensor is the same, some of its
#: returns are lost.
LOST = 0.2
#: Greatest learning rate of a scan network: twice that of the image networks, as it has few
#: parameters.
SCAN_RATE = 4e-3
#: Beyond it a simulated scan has no return either.
MAX_RANGE_M = 200.0


def train_image_segmenter(
    order: Order, kind: str, width: float, stride: int, console: Console
) -> Path:
    """A "pyramid" on a residual backbone or a "deeplab" times `width`, on a flight's color cameras;
    its registry. Raises OverflightError, Interrupted."""
    images = read_images(order.data)
    torch.manual_seed(order.seed)
    network = (
        DeepLab(CHANNELS, width=width, stride=stride)
        if kind == "deeplab"
        else PyramidSegmenter(ResidualBackbone.slim(3), CHANNELS, stride=stride)
    )
    architecture = (
        f"DeepLabv3+ on MobileNetV3 (minimalistic) x {width:g}"
        if kind == "deeplab"
        else "feature pyramid on a slim residual backbone"
    )
    chosen = images[:: max(1, len(images) // SAMPLES)]
    inputs = [_padded(one.pixels) for one in chosen]
    cells = [_at_corners(one.classes, stride) for one in chosen]
    plan = Plan(
        name="segment-rgb",
        architecture=f"{architecture}, stride {stride}",
        task=ImageSegmenter(network, images, stride),
        shape=(3, IMAGE_SIZE[1], IMAGE_SIZE[0]),
        outputs=network.output_names,
        meaning=Meaning(
            description="Classes of the taxonomy in color images, trained on simulation alone",
            license=order.license,
            source=f"overflight train segment-rgb; {order.attribution}",
            head={"kind": "scores", "align_corners": True},
            classes={},
            color="rgb",
            mean=MEAN,
            std=STD,
        ),
        samples=inputs,
        data=f"{order.data.name}: {len(images):,} images",
        finish=lambda trained: balance(trained, inputs, cells),
    )
    return carry_out(plan, order, console)


def train_scan_segmenter(
    order: Order, width: float, statistics: Path, sensor: str, console: Console
) -> Path:
    """SalsaNext on the LiDARs of a flight; its registry. Raises OverflightError, Interrupted."""
    entry = ScanStatistics.read(statistics, sensor)
    scans = read_scans(order.data, entry.elevation_rad)
    torch.manual_seed(order.seed)
    network = SalsaNext(CHANNELS, width=width)
    task = ScanSegmenter(network, scans, entry.mean, entry.std, lost=LOST)
    chosen = scans[:: max(1, len(scans) // SAMPLES)]
    inputs = [task.as_input(one) for one in chosen]
    plan = Plan(
        name="segment-scan",
        architecture=f"SalsaNext x {width:g}",
        task=task,
        shape=(5, SCAN_SIZE[1], SCAN_SIZE[0]),
        outputs=network.output_names,
        meaning=Meaning(
            description="Classes of the taxonomy in LiDAR scans, trained on simulation alone",
            license=order.license,
            source=f"overflight train segment-scan; {order.attribution}",
            head={"kind": "scores", "align_corners": False},
            classes={},
            color=None,
            mean=0.0,
            std=1.0,
        ),
        samples=inputs,
        data=f"{order.data.name}: {len(scans):,} scans, normalized as {sensor}",
        rate=SCAN_RATE,
        finish=lambda trained: balance(trained, inputs, [one.classes for one in chosen]),
    )
    return carry_out(plan, order, console)


def read_images(flight: Path) -> list[LabeledImage]:
    """The color images of a flight, or of Mapillary Vistas, with their labels. Raises DataError."""
    if vistas.fits(flight):
        return vistas.read_vistas(flight)
    found = [
        LabeledImage(np.asarray(image.data, dtype=np.uint8), truth.classes)
        for image, truth in with_truth(flight, Image, Labels)
        if image.data.ndim == 3
    ]
    if not found:
        raise DataError(f"{flight}: has no labeled images in color")
    return found


def read_scans(flight: Path, elevation_rad: tuple[float, float]) -> list[LabeledScan]:
    """The scans of a flight as range images with the class of each cell. Raises DataError."""
    image = RangeImage((SCAN_SIZE[1], SCAN_SIZE[0]), elevation_rad, MAX_RANGE_M)
    nothing, one = (as_input(np.full(5, value, dtype=np.float32)) for value in (0, 1))
    found = []
    for scan, truth in with_truth(flight, Scan, Labels):
        nearest = image.places(scan)[0]
        classes = np.where(nearest >= 0, truth.classes.ravel()[nearest], 0)
        found.append(LabeledScan(image.channels(scan, nothing, one), classes.astype(np.uint8)))
    return found


def _at_corners(classes: NDArray[np.uint8], stride: int) -> NDArray[np.uint8]:
    """The class of every cell: those of an image with one row and column more lie on its pixels."""
    height, width = classes.shape
    columns, rows = ((side - 1) // stride for side in IMAGE_SIZE)
    at_row = np.minimum(np.arange(rows + 1) * stride, height - 1)
    at_column = np.minimum(np.arange(columns + 1) * stride, width - 1)
    return np.ascontiguousarray(classes[np.ix_(at_row, at_column)])


def _padded(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(3, height, width) with the last row and column twice, as the stage pads a short image."""
    width, height = IMAGE_SIZE
    more = ((0, max(0, height - pixels.shape[0])), (0, max(0, width - pixels.shape[1])), (0, 0))
    values = np.pad(pixels, more, mode="edge")[:height, :width].astype(np.float32)
    return np.ascontiguousarray(((values - MEAN) / STD).transpose(2, 0, 1))
