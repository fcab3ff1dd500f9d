"""When an emulated device fails: a schedule that a graph file states and a test can repeat."""

from __future__ import annotations

from enum import Enum
from typing import Annotated, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

Seconds = Annotated[float, Field(ge=0)]


class Fault(Enum):
    """What becomes of one run."""

    DEAD = "dead"
    HANGS = "hangs"
    RAISES = "raises"


class Faults(BaseModel):
    """The faults of a device. Seconds count from its first run after warming up, by the wall."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    dies_at_s: Seconds | None = Field(None, description="every run fails from here on")
    returns_at_s: Seconds | None = Field(None, description="until here; never where left out")
    hangs_at_s: Seconds | None = Field(None, description="the first run from here on hangs")
    hangs_for_s: Seconds | None = Field(None, description="for so long; without end if left out")
    raises_every: int | None = Field(None, ge=1, description="every n-th run fails")
    raise_probability: float = Field(0.0, ge=0, le=1, description="of each run, by the seed")
    repeat_s: Seconds | None = Field(None, gt=0, description="dies and hangs again every so often")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.returns_at_s is not None and not (
            self.dies_at_s is not None and self.dies_at_s < self.returns_at_s
        ):
            raise ValueError("returns_at_s has to follow a dies_at_s")
        if self.hangs_for_s is not None and self.hangs_at_s is None:
            raise ValueError("hangs_for_s needs a hangs_at_s")
        last = max(self.dies_at_s or 0, self.returns_at_s or 0, self.hangs_at_s or 0)
        if self.repeat_s is not None and self.repeat_s <= last:
            raise ValueError("repeat_s has to be longer than what it repeats")
        return self


class FaultSchedule:
    """Says run by run what fails; one thread at a time."""

    def __init__(self, faults: Faults, seed: int = 0) -> None:
        self._faults = faults
        self._random = np.random.default_rng(seed)
        self._runs = 0
        self._hung = -1  #: the repetition in which a run hung last

    def dead(self, at_s: float) -> bool:
        """Whether the device is gone at this time."""
        at_s, _ = self._in_repetition(at_s)
        faults = self._faults
        if faults.dies_at_s is None or at_s < faults.dies_at_s:
            return False
        return faults.returns_at_s is None or at_s < faults.returns_at_s

    def next_run(self, at_s: float) -> Fault | None:
        """What becomes of the run that starts now."""
        faults = self._faults
        self._runs += 1
        unlucky = self._random.random() < faults.raise_probability  # drawn by every run alike
        if self.dead(at_s):
            return Fault.DEAD
        at_s, repetition = self._in_repetition(at_s)
        due = faults.hangs_at_s is not None and at_s >= faults.hangs_at_s
        if due and repetition > self._hung:
            self._hung = repetition
            return Fault.HANGS
        every = faults.raises_every
        return Fault.RAISES if unlucky or (every and self._runs % every == 0) else None

    def _in_repetition(self, at_s: float) -> tuple[float, int]:
        if self._faults.repeat_s is None:
            return at_s, 0
        repetition = int(at_s // self._faults.repeat_s)
        return at_s - repetition * self._faults.repeat_s, repetition
