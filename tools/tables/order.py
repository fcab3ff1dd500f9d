"""What a person asks of a table: where to, how many seeds, how long."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class TableOrder:
    """What a person asked for."""

    output: Path
    seeds: int
    steps: int | None
    quick: bool
    shared: Path
    threads: int  #: of each training
    jobs: int  #: networks of a simulated table that are trained at once
