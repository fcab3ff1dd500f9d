"""The first half of a propagation: the graph that observes, run offline once per recording."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from rich.console import Console

from pipeline.drivers.run import run_graph
from pipeline.errors import DataError, StageError
from stages.sinks.whole_file import whole_file
from tools.load import open_graph
from tools.watching.progress import Progress

GRAPHS = Path(__file__).resolve().parents[2] / "graphs"
FOLDER, NOTE = "observations", "observations.json"


@dataclass(frozen=True, slots=True)
class Order:
    """What is to be observed, and by what."""

    recording: Path
    graph: Path
    models: tuple[Path, ...] = ()
    settings: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        recording: Path,
        graph: Path | None,
        models: Sequence[Path] = (),
        settings: Sequence[str] = (),
    ) -> Order:
        """The shipped graph that fits the recording, unless one is named. Raises DataError."""
        if not recording.exists():
            raise DataError(f"{recording}: no such file or folder")
        if graph is None:
            name = "label_propagation_drive" if recording.is_dir() else "label_propagation"
            graph = GRAPHS / f"{name}.yaml"
        return cls(recording, graph, tuple(models), tuple(settings))

    def note(self) -> dict[str, object]:
        """What observations were made from; others are made anew."""
        file = self.recording / "poses_lidar_odometry.txt"
        seen = self.recording if self.recording.is_file() else file if file.exists() else None
        return {
            "recording": str(self.recording.resolve()),
            "bytes": seen.stat().st_size if seen else None,
            "changed": seen.stat().st_mtime_ns if seen else None,
            "graph": self.graph.name,
            "graph_sha256": digest_of(self.graph),
            "models": [str(model.resolve()) for model in self.models],
            "settings": list(self.settings),
        }


def digest_of(graph: Path) -> str:
    """Of a graph file and of all that it includes: another graph observes otherwise.

    What cannot be read is left to the graph's own errors.
    """
    digest, waiting, seen = hashlib.sha256(), [graph], set[Path]()
    while waiting:
        file = waiting.pop().resolve()
        if file in seen or not file.is_file():
            continue
        seen.add(file)
        content = file.read_bytes()
        digest.update(content)
        with contextlib.suppress(yaml.YAMLError, AttributeError, TypeError):
            includes = yaml.safe_load(content).get("include", [])
            waiting += [file.parent / str(name) for name in includes]
    return digest.hexdigest()


def observe(order: Order, output: Path, console: Console) -> tuple[list[Path], bool]:
    """The files of the observations in `output`, by stamp, and whether they were there already.

    A run that was stopped is begun anew. Raises OverflightError.
    """
    folder, note = output / FOLDER, output / NOTE
    made_from = order.note()
    if note.is_file() and json.loads(note.read_text()) == made_from:
        return files_in(folder), True
    note.unlink(missing_ok=True)
    for old in folder.glob("*.npz"):
        old.unlink()
    parameter = "recording" if order.recording.is_dir() else "flight"
    settings = (f"parameters.{parameter}={order.recording.resolve()}", *order.settings)
    graph, catalog = open_graph(order.graph, settings, (), order.models, output)
    with Progress(graph.topology, console) as progress:
        result = run_graph(graph, catalog, speed=None, progress=progress)
    if result.failures:
        raise StageError(f"{order.graph.name}: {'; '.join(result.failures)}")
    if result.ended.startswith("signal"):
        raise KeyboardInterrupt
    found = files_in(folder)
    with whole_file(note) as file:
        file.write(json.dumps(made_from, indent=2).encode())
    return found, False


def files_in(folder: Path) -> list[Path]:
    """The observations of a folder, by stamp. Raises DataError where it has none."""
    found = sorted(folder.glob("*.npz"))
    if not found:
        raise DataError(
            f"{folder}: holds no observations; does the graph have a stage WriteObservations with "
            "scans and poses before it?"
        )
    return found
