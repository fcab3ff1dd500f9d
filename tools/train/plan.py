"""One training from its data to what flies: what is common to all networks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from torch import nn

from pipeline.errors import DataError
from tools.train.beginning import begin_with, weights_of_training
from tools.train.blocks import parameters_of
from tools.train.card import Origin, model_card
from tools.train.checkpoint import CHECKPOINT
from tools.train.export import Exportable
from tools.train.file_weights import weights_of_file
from tools.train.loop import Training
from tools.train.products import REGISTRY, Meaning, write_products
from tools.train.task import AVERAGING, Settings, Task

#: A network that begins with its own weights of another training learns at this share of the rate.
FINE_TUNING = 0.5


@dataclass(frozen=True, slots=True)
class Order:
    """What a person asked for, of any network."""

    data: Path
    output: Path
    steps: int
    seed: int
    threads: int
    license: str
    attribution: str
    command: str  #: the words that ask for it again
    judged_on: Path | None = None
    restart: bool = False
    start: Path | None = None  #: a training's folder or IR (.xml), whose weights this begins with
    gathered: int = 1  #: batches to a step, see `Settings`
    as_it_is: bool = False  #: write the files of what was learned so far instead of learning on
    quantized: bool = True  #: write the 8-bit file as well, which takes a minute


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be trained, and what will be said of it."""

    name: str  #: in the registry
    architecture: str
    task: Task
    shape: tuple[int, int, int]  #: channels, height, width of the input of the exported files
    outputs: tuple[str, ...]
    meaning: Meaning
    samples: Sequence[NDArray[np.float32]]  #: inputs (channels, height, width) for the 8-bit file
    data: str  #: in words
    rate: float = 2e-3
    judge: Callable[[Path], Sequence[Mapping[str, Any]]] | None = None  #: of a registry file
    finish: Callable[[nn.Module], None] | None = None  #: the last touch of the trained network


def _so_far(training: Training) -> nn.Module:
    if not training.step:
        raise DataError(f"{training.folder}: holds no training to be written as it is")
    return training.averaged


def _begun(task: Task, start: Path, seed: int) -> bool:
    """Give the network weights to begin with; whether all of its own."""
    if start.suffix == ".xml":
        inputs = task.batch(np.random.default_rng(seed))["input"]
        weights = weights_of_file(task.network, start, inputs)
    else:
        weights = weights_of_training(start / CHECKPOINT)
    return begin_with(task.network, weights, start)


def carry_out(plan: Plan, order: Order, console: Console) -> Path:
    """Train, or go on, and write everything; the registry. Raises OverflightError, Interrupted."""
    if order.restart:
        for name in (CHECKPOINT, "curve.csv"):
            (order.output / name).unlink(missing_ok=True)
    facts = {"network": f"{plan.name}, {plan.architecture}", "data": plan.data}
    rate = plan.rate
    if order.start is not None:
        facts["start"] = order.start.name
        if _begun(plan.task, order.start, order.seed):
            rate *= FINE_TUNING
    if order.gathered > 1:
        facts["gathered"] = str(order.gathered)
    settings = Settings(
        steps=order.steps,
        gathered=order.gathered,
        seed=order.seed,
        rate=rate,
        # Over a seventh of a short training: a longer memory still holds how it began.
        averaging=min(AVERAGING, 1 - 7 / max(order.steps, 7)),
        threads=order.threads,
        facts=facts,
    )
    training = Training(plan.task, settings, order.output)
    network = _so_far(training) if order.as_it_is else training.run(console)
    if plan.finish is not None:
        plan.finish(network)
    console.print("writing the model files ...", highlight=False)
    model = Exportable(plan.name, network, plan.shape, plan.outputs)
    samples = plan.samples if order.quantized else ()
    files = write_products(model, plan.meaning, samples, order.output, console)
    registry = order.output / REGISTRY
    verdicts = plan.judge(registry) if plan.judge is not None else ()
    origin = Origin(
        command=order.command,
        data=plan.data,
        license=order.license,
        attribution=order.attribution,
        steps=training.step,
        seed=order.seed,
        minutes=training.seconds / 60,
        parameters=parameters_of(network),
        loss=training.curve.lately,
    )
    card = model_card(
        plan.name, plan.meaning.description, plan.architecture, origin, files, verdicts
    )
    (order.output / f"{plan.name}.md").write_text(card, encoding="utf-8")
    return registry
