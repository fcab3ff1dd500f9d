"""`overflight train detect-thermal` and `detect-rgb`: labeled pictures to a detector that flies."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console

from accelerators.registry import Registry
from stages.taxonomy import load_taxonomy
from tools.annotated_images import read_annotated
from tools.evaluate_detections import judge, open_model, summary
from tools.train.center_net import CenterNet
from tools.train.crops import Crops
from tools.train.detector import MEAN, STD, Detector
from tools.train.mobiledet import MobileDet
from tools.train.pictures import LabeledPicture, read_pictures
from tools.train.plan import Order, Plan, carry_out
from tools.train.products import Meaning
from tools.train.recipes import DetectorRecipe
from tools.train.residual_backbone import ResidualBackbone
from tools.train.ssd import Ssd, SsdDetector
from tools.train.task import Task

#: So many images tell the 8-bit file which values each tensor takes: of 48 thermal ones none had
#: the largest vehicles, whose AP fell by 12 points in 8 bits, and by none of 200.
SAMPLES = 200
#: Width of the MobileDet that takes as long for a frame as the residual backbone.
MOBILEDET_WIDTH = 0.5


def train_detector(
    recipe: DetectorRecipe, order: Order, backbone: str, head: str, console: Console
) -> Path:
    """Train, or go on, then write the files; their registry. Raises OverflightError, Interrupted.

    `backbone` is "residual" or "mobiledet", `head` "centernet" or "ssd".
    """
    taxonomy = load_taxonomy()
    labels = [taxonomy.id(name) for name in recipe.odds]
    pictures = read_pictures(order.data, recipe.channels)
    odds = list(recipe.odds.values())
    crops = Crops(pictures, labels, odds, side=recipe.side, augmentation=recipe.augmentation)
    torch.manual_seed(order.seed)
    network, task = _network(recipe, backbone, head, crops)
    width, height = recipe.size
    judged_on = order.judged_on
    slim = recipe.slim and backbone == "residual"
    plan = Plan(
        name=recipe.name,
        architecture=f"{head} on a {'slim ' * slim}{backbone} backbone",
        task=task,
        shape=(recipe.channels, height, width),
        outputs=network.output_names,
        meaning=Meaning(
            description=recipe.description,
            license=order.license,
            source=f"overflight train {recipe.name}; {order.attribution}",
            head=network.registry_head(),
            classes=recipe.class_map,
            color=recipe.color,
            mean=MEAN,
            std=STD,
        ),
        samples=[_as_input(one.pixels, recipe.size) for one in spread(pictures, SAMPLES)],
        data=_in_words(order.data, pictures, recipe, labels),
        judge=None if judged_on is None else lambda file: _judge(recipe.name, file, judged_on),
    )
    return carry_out(plan, order, console)


def _network(
    recipe: DetectorRecipe, backbone: str, head: str, crops: Crops
) -> tuple[CenterNet | Ssd, Task]:
    body: MobileDet | ResidualBackbone
    if backbone == "mobiledet":
        body = MobileDet(recipe.channels, MOBILEDET_WIDTH)
    elif recipe.slim:
        body = ResidualBackbone.slim(recipe.channels)
    else:
        body = ResidualBackbone(recipe.channels)
    if head == "ssd":
        ssd = Ssd(body, len(recipe.odds))
        return ssd, SsdDetector(ssd, crops, recipe.side, recipe.batch_size)
    center_net = CenterNet(body, len(recipe.odds))
    return center_net, Detector(center_net, crops, len(recipe.odds), recipe.batch_size)


def spread(pictures: Sequence[LabeledPicture], count: int) -> list[LabeledPicture]:
    """So many of the pictures, evenly over all of them."""
    chosen = np.linspace(0, len(pictures) - 1, min(count, len(pictures))).round().astype(int)
    return [pictures[index] for index in chosen]


def _as_input(pixels: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.float32]:
    """(channels, height, width), as the network gets it."""
    fitted = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    channels_last = fitted.reshape(*fitted.shape[:2], -1)
    values = (channels_last.astype(np.float32) - MEAN) / STD
    return np.ascontiguousarray(values.transpose(2, 0, 1))


def _judge(name: str, registry: Path, folder: Path) -> list[Mapping[str, Any]]:
    models, images = Registry.open(registry), read_annotated(folder)
    verdicts: list[Mapping[str, Any]] = []
    for variant in models.entry(name).variants:
        if variant.kind != "onnx":  # the same network as the IR, which is smaller
            bound, device = open_model(models, name, variant.kind)
            facts = {"device": device, "images": len(images), "judged_on": folder.name}
            verdicts.append({**facts, "min_iou": 0.5, **summary(judge(bound, images, min_iou=0.5))})
    return verdicts


def _in_words(
    data: Path, pictures: Sequence[LabeledPicture], recipe: DetectorRecipe, labels: Sequence[int]
) -> str:
    count = Counter(int(label) for one in pictures for label in one.classes)
    objects = ", ".join(
        f"{name} {count[label]:,}" for name, label in zip(recipe.odds, labels, strict=True)
    )
    return f"{data.name}: {len(pictures):,} pictures, boxes: {objects}"
