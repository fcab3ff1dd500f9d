"""Payload classes of a graph that only these tests have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum

import numpy as np
from numpy.typing import NDArray


class Color(Enum):
    RED = 1
    GREEN = 2


class Mode(StrEnum):
    HOVER = "hover"


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    corners: NDArray[np.float32]
    label: str
    color: Color = Color.RED


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    boxes: tuple[Box, ...]
    mode: Mode
    grid: NDArray[np.float32] | None
    names: Mapping[str, int]
    raw: bytes = b""
    total: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "total", len(self.boxes))


@dataclass(frozen=True)
class Even:
    """Refuses odd numbers, as a class may."""

    number: int

    def __post_init__(self) -> None:
        if self.number % 2:
            raise LookupError("odd")


@dataclass(frozen=True)
class Undeclared:
    number: int
