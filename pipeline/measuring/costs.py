"""What steps cost on which device, and when sensors speak: what a plan is made from.

A cost table is a YAML file, written by `overflight profile --save-costs` or by hand:

    machine: {cores: 2, event_us: 60}
    sources: {rgb: {period_ms: 33.3, jitter_ms: 1, delay_ms: 0}}
    costs:
      - {stage: detect_rgb, device: edgetpu, prepare_ms: {p50: 0.9, p99: 1.4}, infer_ms: 17.5,
         finish_ms: 0.3, cpu_ms: {prepare: 0.9, infer: 0.1, finish: 0.3}}
      - {stage: fuse_image, device: cpu, process_ms: {p50: 19.8, p99: 26}, cpu_ms: {process: 19.5}}

A time is the wall time of one step; a bare number is p50 and p99 at once. `cpu_ms` is the mean CPU
time of the same steps; a step on a CPU worker that it leaves out is taken to compute all the time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from pipeline.errors import DataError
from pipeline.graph.wording import explain
from pipeline.scheduling.events import Step

#: Standard deviations from the median to the 99th percentile of a normal distribution.
Z99 = 2.3263


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class Spread(_Entry):
    """The wall time of a step, log-normal through its median and 99th percentile."""

    p50: float = Field(ge=0, le=3_600_000)  #: ms
    p99: float = Field(ge=0, le=3_600_000)  #: ms

    @model_validator(mode="after")
    def _in_order(self) -> Spread:
        if self.p99 < self.p50:
            raise ValueError(f"p99 ({self.p99:g}) is below p50 ({self.p50:g})")
        return self

    @property
    def sigma(self) -> float:
        """Standard deviation of the logarithm."""
        return math.log(self.p99 / self.p50) / Z99 if self.p50 > 0 else 0.0

    @property
    def mean(self) -> float:
        """ms"""
        return self.p50 * math.exp(self.sigma**2 / 2)


def _as_spread(value: object) -> object:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return {"p50": value, "p99": value} if is_number else value


_Time = Annotated[Spread, BeforeValidator(_as_spread)]
_Ms = Annotated[float, Field(ge=0, le=3_600_000)]


class StageCost(_Entry):
    """One stage on one device; a stage without a model has `process_ms` alone."""

    stage: str
    device: str = "cpu"
    prepare_ms: _Time | None = None
    infer_ms: _Time | None = None
    finish_ms: _Time | None = None
    process_ms: _Time | None = None
    cpu_ms: Mapping[Step, _Ms] = {}  #: mean CPU time of a step

    def time(self, step: Step) -> Spread | None:
        """The wall time of a step; None where nothing is known of it."""
        time: Spread | None = getattr(self, f"{step}_ms")
        return time

    def cpu(self, step: Step) -> float:
        """Mean CPU of a step, ms: the whole step on a CPU worker unless the table knows better."""
        time = self.time(step)
        everything = 0.0 if time is None or step is Step.INFER else time.mean
        return self.cpu_ms.get(step, everything)


class SourceCost(_Entry):
    """When a sensor speaks; its stamps lie `period_ms` apart."""

    period_ms: float = Field(gt=0, le=3_600_000)
    jitter_ms: _Ms = 0.0  #: half-width of a stamp's uniform jitter
    delay_ms: _Ms = 0.0  #: arrival after the stamp
    phase_ms: float | None = None  #: of the stamps; None: the sensor runs free
    extent_ms: _Ms | None = None  #: how far begin and end lie from the stamp; None: not at all

    @model_validator(mode="after")
    def _in_order(self) -> SourceCost:
        if 2 * self.jitter_ms >= self.period_ms:
            raise ValueError("jitter_ms must be below half of period_ms, or stamps run backward")
        return self


class Machine(_Entry):
    """The computer that the table speaks of."""

    cores: int = Field(default=2, ge=1, le=4096)
    event_us: float = Field(default=0.0, ge=0)  #: CPU of the framework for each step and message


class Costs(_Entry):
    """A cost table."""

    machine: Machine = Machine()
    sources: Mapping[str, SourceCost] = {}
    costs: tuple[StageCost, ...] = ()

    def of(self, stage: str, device: str | None) -> StageCost | None:
        """What a stage costs on a device (None: it has no model); the last entry counts."""
        for entry in reversed(self.costs):
            if entry.stage == stage and (device is None or entry.device == device):
                return entry
        return None


def read_costs(path: Path) -> Costs:
    """Read a cost table. Raises DataError with every mistake and its place."""
    try:
        content: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: is not YAML: {error}") from None
    try:
        return Costs.model_validate(content or {})
    except ValidationError as error:
        mistakes = (
            f"{path}: {'.'.join(map(str, steps)) or 'the file'}: {sentence}"
            for steps, sentence in explain(error.errors(), content)
        )
        raise DataError("\n".join(mistakes)) from None
