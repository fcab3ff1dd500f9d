"""`overflight train segment-scan` on a mixture of labeled scans: SalsaNext, retrained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from torch import nn

from stages.scan_statistics import SHIPPED
from stages.types import CHANNELS
from tools.models.add import add_model
from tools.models.entry import Said
from tools.train.balance import balance
from tools.train.export import Exportable, write_onnx, write_openvino
from tools.train.plan import Order, Plan, carry_out
from tools.train.point_segmenter import PointSegmenter
from tools.train.products import REGISTRY, SAMPLES
from tools.train.salsanext import SalsaNext
from tools.train.scan_mix import open_mix
from tools.train.scan_network import RATE, SIZE, calibration, meaning_of_scans
from tools.train.scan_recipes import recipe_named

#: Parts of scans that are learned from at once; a larger batch is gathered from several.
AT_ONCE = 4


@dataclass(frozen=True, slots=True)
class ScanChoices:
    """What a person may choose of a scan network."""

    width: float = 0.5
    sensor: str = "os0_128"
    statistics: Path = SHIPPED
    recipe: str = "plain"
    channels: int | None = None  #: 5 or 4, without remission; None: as the mixture's sensors ask
    name: str = "segment-scan"
    balanced: bool = True
    sizes: tuple[tuple[int, int], ...] = (SIZE,)  #: of files: the first is trained, others as well


def train_from_points(order: Order, choices: ScanChoices, console: Console) -> Path:
    """Train, or go on; the registry. Raises OverflightError, Interrupted."""
    mix = open_mix(order.data, choices.statistics, choices.sensor)
    recipe = recipe_named(choices.recipe)
    channels = choices.channels or mix.channels
    torch.manual_seed(order.seed)
    network = SalsaNext(CHANNELS, channels=channels, width=choices.width)
    task = PointSegmenter(network, mix, recipe, channels=channels, size=SIZE)
    seen = [task.whole(part, scan) for part, scan in mix.sample(SAMPLES)]
    inputs, classes = [one for one, _ in seen], [one for _, one in seen]
    plan = Plan(
        name=choices.name,
        architecture=f"SalsaNext x {choices.width:g}, {channels} channels",
        task=task,
        shape=(channels, *SIZE),
        outputs=network.output_names,
        meaning=meaning_of_scans("Classes of the taxonomy in LiDAR scans", order),
        samples=calibration(inputs),
        data=f"{mix.told}; recipe {recipe.name}, normalized as {choices.sensor}",
        rate=RATE,
        finish=lambda trained: _finish(trained, plan, order, choices, inputs, classes),
    )
    return carry_out(plan, order, console)


def _finish(
    trained: nn.Module,
    plan: Plan,
    order: Order,
    choices: ScanChoices,
    inputs: Sequence[NDArray[np.float32]],
    classes: Sequence[NDArray[np.uint8]],
) -> None:
    """Balance the classes; write the files for larger images, named after their columns."""
    if choices.balanced:
        balance(trained, inputs, classes)
    for size in choices.sizes[1:]:
        name = f"{plan.name}-{size[1]}"
        model = Exportable(name, trained, (plan.shape[0], *size), plan.outputs)
        onnx = write_onnx(model, order.output)
        said = Said(
            head=plan.meaning.head,
            classes={},
            outputs={output: output for output in plan.outputs},
            color=None,
            mean=[plan.meaning.mean],
            std=[plan.meaning.std],
            description=plan.meaning.description,
            license=plan.meaning.license,
            source=plan.meaning.source,
        )
        files = [write_openvino(model, onnx, order.output), onnx]
        add_model(name, files, said, order.output / REGISTRY, replace=True)
