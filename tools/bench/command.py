"""The command's wall time, from its start to its exit, as a user waits for it."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter

from tools.bench.harness import Effort, Row, interleave, quantile, ratio
from tools.bench.scheduler import FILE

FLOOR = "python -c pass"


def measure(effort: Effort) -> list[Row]:
    """The rows, beside the bare interpreter."""
    overflight = Path(sysconfig.get_path("scripts")) / "overflight"
    if not overflight.is_file():
        raise RuntimeError(f"no command at {overflight}; install the project: pip install -e .")
    goals = {
        "overflight --help": 0.3,
        "overflight version": None,
        f"overflight validate graphs/{FILE.name}": 1.0,
    }
    words: dict[str, Sequence[str]] = {
        name: [str(overflight), *last]
        for name, last in zip(
            goals, (["--help"], ["version"], ["validate", str(FILE)]), strict=True
        )
    }
    words[FLOOR] = [sys.executable, "-c", "pass"]
    sides: dict[str, Callable[[], float]] = {
        name: partial(wall_s, each) for name, each in words.items()
    }
    for side in sides.values():
        side()  # fills the caches of the file system and of compiled Python
    walls = interleave(sides, effort.of(9, 2))
    floor = median(walls[FLOOR])
    rows = []
    for name, goal in goals.items():
        wall = median(walls[name])
        rows.append(
            Row(
                f"`{name}`",
                "" if goal is None else f"< {goal:g} s",
                f"{wall:.3f} s, slowest {max(walls[name]):.3f} s",
                f"{FLOOR}: {floor:.3f} s",
                str(ratio(walls[name], walls[FLOOR])),
                None if goal is None else wall < goal,
                {"median_s": wall, "p99_s": quantile(walls[name], 0.99), "floor_s": floor},
            )
        )
    return rows


def wall_s(words: Sequence[str]) -> float:
    """Seconds of one call; raises CalledProcessError where it fails."""
    started = perf_counter()
    subprocess.run(words, check=True, capture_output=True)
    return perf_counter() - started
