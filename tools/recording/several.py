"""The files of one flight: a graph in several processes leaves one for each, and one more for each
time that a process was started anew."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import DataError
from pipeline.recording.flight import Flight
from pipeline.recording.mcap import MAGIC
from pipeline.scheduling.topology import Role


def is_flight(path: Path) -> bool:
    """Whether a file is a recording, whatever it is called."""
    try:
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


def flight_files(path: Path) -> list[Path]:
    """The recordings that ``--record path`` made: `path` itself, or those of the processes.

    Empty where there is none.
    """
    if path.exists():
        return [path] if is_flight(path) else []
    return process_files(path)


def process_files(path: Path) -> list[Path]:
    """The recordings of the processes alone, of each in the order of its starts."""
    beside = filter(is_flight, path.parent.glob(f"{path.stem}.*{path.suffix}"))
    return sorted(beside, key=lambda file: (file.stem.rstrip("0123456789"), len(file.stem), file))


def file_of_stage(path: Path, stage: str) -> Path:
    """The recording in which a stage was scheduled. Raises DataError where several were."""
    files = flight_files(path)
    if len(files) < 2:
        return path
    found = [file for file in files if schedules(file, stage)]
    if len(found) > 1:
        names = " or ".join(map(str, found))
        raise DataError(
            f"{path}: the process of {stage} was started anew, and each start decided for itself, "
            f"from nothing; explain one of them: {names}"
        )
    return found[0] if found else files[0]


def schedules(file: Path, stage: str) -> bool:
    """Whether a recording is of the process that ran a stage."""
    nodes = Flight(file).manifest.topology.stages
    return any(node.name == stage and node.role is not Role.REMOTE for node in nodes)
