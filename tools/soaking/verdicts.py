"""Whether a soaked run is well: every figure beside its bound."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from tools.soaking.watch import SETTLED_S, Life, Watch

#: The longest silence of any output.
MOST_SILENT_S = 5.0
#: From a kill to the first new output of the killed process, 95 of 100.
MOST_BACK_S = 5.0
#: Until then the map fills and the heap finds its size: from there on the memory of a process is
#: judged, where so many of its starts tell.
FULL_S, LEAST_LIVES = 120.0, 3
#: What processes may hold more in the last third of a soak than in the first.
MOST_GROWTH_MB = 16.0
MOST_GROWTH_DESCRIPTORS = 4
MOST_GROWTH_FILES = 4
MOST_GROWTH_SHARED_MB = 64.0


class Verdict(NamedTuple):
    """One figure of the table."""

    what: str
    measured: str
    bound: str
    met: bool


def verdicts(watch: Watch, report: Mapping[str, Any], code: int | None) -> list[Verdict]:
    """What is judged of a run that ended with `code` and left this report."""
    ended = "had to be killed" if code is None else f"exit code {code}"
    found = [
        Verdict("the run", ended if watch.seconds else "never flowed", "exit code 0", code == 0),
        Verdict(
            "ledger across all lives",
            "balanced" if report.get("ledger_balanced") else "not balanced",
            "balanced",
            bool(report.get("ledger_balanced")),
        ),
    ]
    name, gap = max(watch.gaps_s.items(), key=lambda each: each[1], default=("no output", 0.0))
    found.append(_at_most("longest silence of an output", gap, MOST_SILENT_S, "s", f" ({name})"))
    found += _returns(watch)
    found += _lives(watch)
    found += _readings(watch)
    left = len(watch.left_files)
    found.append(_at_most("files left in /dev/shm", left, 0, ""))
    return found


def _returns(watch: Watch) -> list[Verdict]:
    firsts = [kill.first_s for kill in watch.kills if kill.first_s is not None]
    alls = [kill.all_s for kill in watch.kills if kill.all_s is not None]
    if not firsts or not alls:
        return [Verdict("kills survived", str(len(alls)), "at least 1", False)]
    p95 = float(np.quantile(firsts, 0.95))
    return [
        Verdict(
            f"kill to first new output ({len(firsts)} kills)",
            f"p50 {median(firsts):.2f} s, p95 {p95:.2f} s",
            f"p95 <= {MOST_BACK_S:g} s",
            p95 <= MOST_BACK_S,
        ),
        Verdict(
            "kill to all outputs of the process",
            f"p50 {median(alls):.2f} s, p95 {float(np.quantile(alls, 0.95)):.2f} s",
            "",
            True,
        ),
    ]


def _lives(watch: Watch) -> list[Verdict]:
    """Lives of one age are compared, and what a life held more at its end than once settled."""
    by_name: dict[str, list[Life]] = defaultdict(list)
    for life in watch.lives.values():
        if life.settled_mb is not None:
            by_name[life.name].append(life)
    found = []
    for name, lives in sorted(by_name.items()):
        full = [life for life in lives if life.born_s + SETTLED_S >= FULL_S]
        settled = [life.settled_mb for life in full if life.settled_mb is not None]
        files = [n for life in lives if (n := life.settled_descriptors) is not None]
        what = f"{name}: memory of {len(full)} starts after {FULL_S:g} s, each {SETTLED_S:g} s old"
        if len(full) < LEAST_LIVES:
            text = f"too short to tell: {LEAST_LIVES} starts are needed"
            found.append(Verdict(f"{what}: growth", text, "", True))
        else:
            within = max(life.last_mb - (life.settled_mb or 0.0) for life in full)
            note = f" ({settled[0]:.0f} to {settled[-1]:.0f} MB; most in one {within:+.0f} MB)"
            found.append(_grows(what, settled, MOST_GROWTH_MB, "MB", note))
        found.append(_grows(f"{name}: descriptors", files, MOST_GROWTH_DESCRIPTORS, ""))
    return found


def _readings(watch: Watch) -> list[Verdict]:
    readings = watch.readings
    return [
        _grows("supervisor: memory", [r.supervisor_mb for r in readings], MOST_GROWTH_MB, "MB"),
        _grows(
            "supervisor: descriptors",
            [r.supervisor_descriptors for r in readings],
            MOST_GROWTH_DESCRIPTORS,
            "",
        ),
        _grows("files in /dev/shm", [r.files for r in readings], MOST_GROWTH_FILES, ""),
        _grows("in /dev/shm", [r.shared_mb for r in readings], MOST_GROWTH_SHARED_MB, "MB"),
    ]


def growth(values: Sequence[float]) -> float:
    """The median of the last third less that of the first."""
    third = max(1, len(values) // 3)
    return median(values[-third:]) - median(values[:third])


def _grows(what: str, values: Sequence[float], most: float, unit: str, note: str = "") -> Verdict:
    if not values:
        return Verdict(f"{what}: growth", "never read", "to be read", False)
    note = note or f" ({values[0]:g} to {values[-1]:g})"
    return _at_most(f"{what}: growth", growth(values), most, unit, note)


def _at_most(what: str, value: float, most: float, unit: str, note: str = "") -> Verdict:
    unit = f" {unit}" if unit else ""
    return Verdict(what, f"{value:.3g}{unit}{note}", f"<= {most:g}{unit}", value <= most)


def table(judged: Sequence[Verdict], watch: Watch) -> Table:
    """The verdicts for people."""
    made = Table(title=f"{watch.seconds / 60:.1f} minutes, {len(watch.kills)} kills")
    for column in ("", "measured", "bound", ""):
        made.add_column(column, overflow="fold")
    for verdict in judged:
        mark = "[green]met[/green]" if verdict.met else "[red]NOT MET[/red]"
        made.add_row(verdict.what, verdict.measured, verdict.bound, mark if verdict.bound else "")
    return made


def sentence(judged: Sequence[Verdict]) -> str:
    """The end of it, in words."""
    missed = [verdict.what for verdict in judged if not verdict.met]
    if missed:
        return f"Not met ({len(missed)} of {len(judged)}): {'; '.join(missed)}."
    return "Every bound is met."
