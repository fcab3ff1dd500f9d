"""``$run``: a folder of one run alone, for what outlives a process but not the run.

A map's checkpoint there brings it back after a kill, and the next flight begins with an empty map.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pipeline.graph.graph import Graph


def run_folder(out: Path) -> Path:
    """What ``$run`` stands for where ``$out`` stands for `out`."""
    return out / ".run"


@contextlib.contextmanager
def folder_of_this_run(graph: Graph) -> Iterator[None]:
    """Nothing of an earlier run is in it, also of one that was killed; nothing is left of this."""
    if graph.written is None:
        yield
        return
    folder = run_folder(graph.written.out)
    shutil.rmtree(folder, ignore_errors=True)
    try:
        yield
    finally:
        shutil.rmtree(folder, ignore_errors=True)
