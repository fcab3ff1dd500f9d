"""`overflight train segment-rgb`: flights with ground truth to a network for images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console

from pipeline.errors import DataError
from stages.labels import Labels
from stages.types import CHANNELS, Image
from tools.train.balance import balance
from tools.train.deeplab import DeepLab
from tools.train.detector import MEAN, STD
from tools.train.flights import with_truth
from tools.train.plan import Order, Plan, carry_out
from tools.train.products import SAMPLES, Meaning
from tools.train.pyramid_segmenter import PyramidSegmenter
from tools.train.readers import vistas
from tools.train.residual_backbone import ResidualBackbone
from tools.train.segmenter import ImageSegmenter, LabeledImage

#: Width and height of an image: 848 x 480 and one, see DeepLab.
IMAGE_SIZE = (849, 481)


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
