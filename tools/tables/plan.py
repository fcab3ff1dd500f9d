"""What the simulated tables are made of, read from the YAML files beside this module."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field

HERE = Path(__file__).parent


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class RowPlan(_Entry):
    """One row of a table."""

    title: str
    mean: float | None = None  #: the paper's, percent
    network: str | None = None  #: None: the cameras alone
    size: Literal[512, 1024] = 512
    fused: bool = False
    view: Literal["all", "camera"] = "all"
    normal: Literal["adapted", "height", "source"] = "adapted"
    map: bool = False  #: judged as a map, not scan by scan

    @property
    def judged(self) -> str:
        """What is judged and how, for a file's name: rows alike in two tables are judged once."""
        words = ["cameras"]
        if self.network is not None:
            words = [self.network, str(self.size), self.normal, *(["fused"] if self.fused else [])]
        return "-".join([*words, *(["map"] if self.map else []), f"view-{self.view}"])


class TablePlan(_Entry):
    """A table of the paper."""

    title: str
    rows: dict[str, RowPlan]
    flights: list[str] = ["flight_a", "flight_b"]  #: that the rows are judged on

    @property
    def in_paper(self) -> bool:
        """Whether the paper has the table."""
        return any(row.mean is not None for row in self.rows.values())


class NetworkPlan(_Entry):
    """A network and what it learns from."""

    channels: Literal[4, 5]
    recipe: str
    parts: dict[str, float]  #: share by source, see `paper.yaml`
    start: str | None = None


class Flights(_Entry):
    """Simulated flights of one preset."""

    seeds: list[int]
    preset: dict[str, Any]


class FigureFlight(_Entry):
    """A flight of a figure, as changes to flight A of the scale."""

    seed: int
    times: float = Field(1.0, gt=0)  #: as long
    preset: dict[str, Any]

    def of(self, flight: Flights) -> Flights:
        """The flight at the scale of `flight`."""
        preset = flight.preset | self.preset
        preset["duration_s"] = self.times * flight.preset["duration_s"]
        return Flights(seeds=[self.seed], preset=preset)


class Scale(_Entry):
    """How large everything is."""

    source: Flights
    views: Flights
    flight_a: Flights
    flight_b: Flights
    width: float = Field(gt=0)
    steps: int = Field(ge=1)
    batch: int = Field(ge=4, multiple_of=4)


class Plans(_Entry):
    """All tables and networks."""

    tables: dict[str, TablePlan]
    networks: dict[str, NetworkPlan]
    flights: dict[str, FigureFlight]


@cache
def plans() -> Plans:
    """The shipped tables."""
    return Plans.model_validate(yaml.safe_load((HERE / "paper.yaml").read_text("utf-8")))


@cache
def scale_named(name: str) -> Scale:
    """The shipped scale `full` or `quick`."""
    scales = yaml.safe_load((HERE / "scales.yaml").read_text("utf-8"))
    return Scale.model_validate(scales[name])
