"""A filled table for people and for programs: ours beside the paper's, and the order of rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as RichTable

from tools.tables.rows import Verdict


@dataclass(frozen=True, slots=True)
class Line:
    """A row of a table with the verdicts of its seeds."""

    title: str
    verdicts: Sequence[Verdict]
    paper: float | None = None  #: the paper's mean IoU, percent
    note: str = ""

    @property
    def mean(self) -> float:
        """Of the seeds; NaN where none is filled."""
        return float(np.mean([one.mean for one in self.verdicts])) if self.verdicts else np.nan

    @property
    def spread(self) -> float:
        """From the worst seed to the best."""
        means = [one.mean for one in self.verdicts]
        return max(means) - min(means) if means else np.nan

    def of_class(self, name: str) -> float:
        """The mean IoU of a class over the seeds; NaN where it does not occur."""
        found = [one.classes[name] for one in self.verdicts if one.classes.get(name) is not None]
        return float(np.mean([value for value in found if value is not None])) if found else np.nan


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of one experiment."""

    title: str
    lines: Sequence[Line]
    conditions: Sequence[str] = field(default=())  #: what a reader has to know beside it
    measure: str = "IoU in %"  #: of the cells
    value: str = "mean"  #: the column that rows are ordered by

    @property
    def of_the_paper(self) -> bool:
        """Whether the paper has such a table."""
        return any(line.paper is not None for line in self.lines)

    def classes(self) -> list[str]:
        """The columns."""
        found: dict[str, None] = {}
        for line in self.lines:
            for verdict in line.verdicts:
                found |= dict.fromkeys(verdict.classes)
        return list(found)

    def order(self) -> list[tuple[str, str, bool]]:
        """(better, worse, whether it is so here) for every two rows that the paper sets apart."""
        known = [line for line in self.lines if line.paper is not None and line.verdicts]
        return [
            (a.title, b.title, a.mean > b.mean)
            for a in known
            for b in known
            if a.paper is not None and b.paper is not None and a.paper > b.paper
        ]

    def told(self) -> dict[str, Any]:
        """For programs."""
        return {
            "title": self.title,
            "conditions": list(self.conditions),
            "rows": [
                {
                    "title": line.title,
                    "paper": line.paper,
                    "mean": None if np.isnan(line.mean) else line.mean,
                    "spread": None if np.isnan(line.spread) else line.spread,
                    "seeds": [one.mean for one in line.verdicts],
                    "classes": {
                        name: None if np.isnan(line.of_class(name)) else line.of_class(name)
                        for name in self.classes()
                    },
                    "points": dict(line.verdicts[0].points) if line.verdicts else {},
                    "note": line.note,
                }
                for line in self.lines
            ],
            "order": [
                {"better": better, "worse": worse, "holds": holds}
                for better, worse, holds in self.order()
            ],
        }

    def markdown(self) -> str:
        """As it stands in BENCHMARK.md."""
        columns = self.classes()
        head = [self.measure, *columns, self.value, "spread", *["paper"] * self.of_the_paper]
        lines = [f"**{self.title}**", "", "| " + " | ".join(head) + " |"]
        lines.append("|" + "---|" * len(head))
        for line in self.lines:
            cells = [line.title, *(_cell(line.of_class(name)) for name in columns)]
            cells += [f"**{_cell(line.mean)}**", _spread(line)]
            cells += [_cell(line.paper)] * self.of_the_paper
            lines.append("| " + " | ".join(cells) + " |")
        return "\n".join([*lines, "", *(f"- {one}" for one in self._remarks())]) + "\n"

    def show(self, console: Console) -> None:
        """On a terminal: without the classes where it is too narrow for them."""
        whole = self._shown(self.classes())
        needed = console.measure(whole, options=console.options.update(width=1000)).maximum
        fits = needed <= console.width
        console.print(whole if fits else self._shown([]))
        if not fits:
            told = f"- classes: in the .md file, or on a terminal of {needed} columns"
            console.print(told, highlight=False)
        for remark in self._remarks():
            console.print(f"- {remark}", highlight=False, soft_wrap=True)

    def _shown(self, classes: Sequence[str]) -> RichTable:
        shown = RichTable(title=self.title, title_justify="left", box=None, padding=(0, 1, 0, 0))
        shown.add_column(self.measure, overflow="fold")
        for name in (*classes, self.value, "spread", *["paper"] * self.of_the_paper):
            shown.add_column(name, justify="right")
        for line in self.lines:
            cells = [line.title, *(_cell(line.of_class(name)) for name in classes)]
            cells += [_cell(line.mean), _spread(line), *[_cell(line.paper)] * self.of_the_paper]
            shown.add_row(*cells)
        return shown

    def _remarks(self) -> list[str]:
        remarks = [
            *self.conditions,
            *(f"{line.title}: {line.note}" for line in self.lines if line.note),
        ]
        empty = [line.title for line in self.lines if not line.verdicts]
        if empty:
            remarks.append(f"not run: {'; '.join(empty)}")
        order = self.order()
        if order:
            holding = sum(holds for _, _, holds in order)
            remarks.append(
                f"of the {len(order)} pairs that the paper sets apart, {holding} hold here"
            )
            remarks += [f"not here: {a} > {b}" for a, b, holds in order if not holds]
        return remarks


def _cell(value: float | None) -> str:
    return "-" if value is None or np.isnan(value) else f"{value:.1f}"


def _spread(line: Line) -> str:
    count = len(line.verdicts)
    if count == 0:
        return "-"
    return f"{count} seed" if count == 1 else f"{line.spread:.1f} ({count})"
