"""What validation and the drivers may ask of models: answered by `accelerators.registry`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from pipeline.model import Accelerator, BoundModel, ModelSpec


class Catalog(Protocol):
    """The models that a graph file may name."""

    def names(self) -> Sequence[str]:
        """Every model name, for checks and suggestions."""
        ...

    def spec(self, name: str) -> ModelSpec:
        """What the variants of a model have in common. Raises ModelError."""
        ...

    def check(self, name: str, device: Accelerator) -> str | None:
        """Why this device cannot run this model, as a sentence with the way out; None when it can.

        No variant of its kinds, a missing file, a wrong sha256. Loads nothing.
        """
        ...

    def load(self, name: str, device: Accelerator) -> BoundModel:
        """Load the variant that the device runs best, warmed up. Raises ModelError, DeviceError."""
        ...
