"""`overflight train segment-scan` on a mixture of labeled scans: SalsaNext, retrained."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from rich.console import Console

from stages.scan_statistics import SHIPPED
from stages.types import CHANNELS
from tools.train.balance import balance
from tools.train.plan import Order, Plan, carry_out
from tools.train.point_segmenter import PointSegmenter
from tools.train.products import SAMPLES, Meaning
from tools.train.salsanext import SalsaNext
from tools.train.scan_mix import open_mix
from tools.train.scan_recipes import recipe_named

#: Rows and columns of the range image.
SIZE = (64, 512)
#: Parts of scans that are learned from at once; a larger batch is gathered from several.
AT_ONCE = 4


@dataclass(frozen=True, slots=True)
class ScanChoices:
    """What a person may choose of a scan network."""

    width: float = 0.5
    sensor: str = "os0_128"
    statistics: Path = SHIPPED
    recipe: str = "plain"
    channels: int = 5
    name: str = "segment-scan"
    balanced: bool = True


def train_from_points(order: Order, choices: ScanChoices, console: Console) -> Path:
    """Train, or go on; the registry. Raises OverflightError, Interrupted."""
    mix = open_mix(order.data, choices.statistics, choices.sensor)
    recipe = recipe_named(choices.recipe)
    torch.manual_seed(order.seed)
    network = SalsaNext(CHANNELS, channels=choices.channels, width=choices.width)
    task = PointSegmenter(network, mix, recipe, channels=choices.channels, size=SIZE)
    seen = [task.whole(part, scan) for part, scan in mix.sample(SAMPLES)]
    inputs, classes = [one for one, _ in seen], [one for _, one in seen]
    plan = Plan(
        name=choices.name,
        architecture=f"SalsaNext x {choices.width:g}, {choices.channels} channels",
        task=task,
        shape=(choices.channels, *SIZE),
        outputs=network.output_names,
        meaning=Meaning(
            description="Classes of the taxonomy in LiDAR scans",
            license=order.license,
            source=f"overflight train segment-scan; {order.attribution}",
            head={"kind": "scores", "align_corners": False},
            classes={},
            color=None,
            mean=0.0,
            std=1.0,
        ),
        samples=inputs,
        data=f"{mix.told}; recipe {recipe.name}, normalized as {choices.sensor}",
        finish=(lambda trained: balance(trained, inputs, classes)) if choices.balanced else None,
    )
    return carry_out(plan, order, console)
