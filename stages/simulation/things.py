"""The register of things: every object of the district with its class."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stages.taxonomy import load_taxonomy

SKY = 0  #: the thing of a pixel whose ray hits nothing


@dataclass(slots=True)
class Things:
    """Objects by number; the number is the instance in the ground truth."""

    classes: list[int] = field(default_factory=lambda: [load_taxonomy().id("sky")])

    def new(self, class_name: str) -> int:
        """A further thing of a class of the shipped taxonomy."""
        self.classes.append(load_taxonomy().id(class_name))
        return len(self.classes) - 1

    def table(self) -> NDArray[np.uint8]:
        """(things,) the class of each."""
        return np.array(self.classes, dtype=np.uint8)
