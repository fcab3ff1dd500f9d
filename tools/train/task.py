"""What the training loop asks of a task: a network, batches, a loss."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from torch import Tensor, nn

#: Weights of a long training are averaged over some 500 steps.
AVERAGING = 0.998


class Task(Protocol):
    """One network learning from one kind of data."""

    network: nn.Module

    def batch(self, random: np.random.Generator) -> dict[str, Tensor]:
        """`input` and what the loss compares with; the same generator, the same batch."""

    def loss(self, outputs: Any, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The parts of the loss by name; their sum is minimized."""


@dataclass(frozen=True, slots=True)
class Settings:
    """How long and how fast to learn."""

    steps: int
    seed: int = 0
    rate: float = 2e-3  #: greatest learning rate of AdamW
    weight_decay: float = 0.02
    warm_up: float = 0.04  #: share of the steps in which the rate rises; then it falls as a cosine
    largest_gradient: float = 10.0
    averaging: float = AVERAGING  #: of the weights (EMA), towards their past
    threads: int = 1
    gathered: int = 1  #: batches whose gradients one step takes: a larger batch in little memory
    facts: Mapping[str, Any] = field(
        default_factory=dict
    )  #: what else a checkpoint must agree with

    def rate_at(self, step: int) -> float:
        """The learning rate of a step."""
        rising = max(1, round(self.warm_up * self.steps))
        if step < rising:
            return self.rate * (step + 1) / rising
        done = (step - rising) / max(1, self.steps - rising)
        return float(self.rate * 0.5 * (1 + np.cos(np.pi * done)))
