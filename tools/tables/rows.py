"""A table's rows as they are filled: one file each, so that a stopped table goes on."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from pipeline.errors import DataError
from stages.evaluation_groups import load_groups
from stages.kernels.evaluation import agreement, group_columns
from stages.kernels.metrics import merge_groups
from stages.sinks.whole_file import whole_file


@dataclass(frozen=True, slots=True)
class Verdict:
    """How right one row is, in percent."""

    mean: float
    classes: Mapping[str, float | None]  #: IoU; None where the class neither is nor was said
    points: Mapping[str, int]  #: of each class
    facts: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        matrix: NDArray[np.int64],
        groups: str,
        *,
        min_points: float = 0.001,
        facts: Mapping[str, Any] | None = None,
    ) -> Verdict:
        """Of a confusion (16, 16) of our classes, judged by groups of them; classes with fewer than
        `min_points` (below 1: a share) are shown and not in the mean."""
        names = load_groups(groups)
        judged = agreement(merge_groups(matrix, group_columns(names)), min_points=min_points)
        order = list(enumerate(names, start=1))
        return cls(
            mean=100 * judged.mean,
            classes={
                name: None if np.isnan(judged.iou[k]) else 100 * float(judged.iou[k])
                for k, name in order
            },
            points={name: int(judged.points[k]) for k, name in order},
            facts=facts or {},
        )


class Rows:
    """The verdicts of a table, by row and seed, in a folder."""

    def __init__(self, folder: Path, conditions: Mapping[str, Any], console: Console) -> None:
        """`conditions` is what all rows have in common; rows of others are refused (DataError)."""
        self._folder = folder
        self._console = console
        note = folder / "conditions.json"
        text = json.dumps(conditions, indent=2, sort_keys=True)
        if note.is_file() and note.read_text() != text:
            raise DataError(
                f"{note}: rows of other conditions lie there; take another --out, or remove it"
            )
        with whole_file(note) as file:
            file.write(text.encode())

    def filled(self, row: str, seed: int, fill: Callable[[], Verdict]) -> Verdict:
        """The row's verdict: read where it is there, else made and written."""
        held = self.read(row, seed)
        if held is not None:
            return held
        self._console.print(f"row '{row}', seed {seed} ...", highlight=False)
        verdict = fill()
        content = {
            "mean": verdict.mean,
            "classes": dict(verdict.classes),
            "points": dict(verdict.points),
            "facts": dict(verdict.facts),
        }
        with whole_file(self._path(row, seed)) as file:
            file.write(json.dumps(content, indent=2).encode())
        self._console.print(f"row '{row}', seed {seed}: {verdict.mean:.1f} %", highlight=False)
        return verdict

    def read(self, row: str, seed: int) -> Verdict | None:
        """The row's verdict, None where it is not filled yet."""
        path = self._path(row, seed)
        if not path.is_file():
            return None
        content = json.loads(path.read_text())
        return Verdict(content["mean"], content["classes"], content["points"], content["facts"])

    def _path(self, row: str, seed: int) -> Path:
        return self._folder / "rows" / f"{row}-{seed}.json"
