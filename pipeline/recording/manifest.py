"""What a recording says of the run that it holds: the graph, the versions, the machine."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

from pydantic import TypeAdapter, ValidationError

from pipeline.errors import DataError
from pipeline.scheduling.topology import Port, Sync, Topology

#: The name of the file's note, and of the form of what is in it.
NOTE = "overflight"
FORMAT = 1

_TOPOLOGY = TypeAdapter(Topology)


@dataclass(frozen=True, slots=True)
class Manifest:
    """One process of one recorded run."""

    graph: str  #: its name
    text: str  #: the graph file with everything that was laid under and over it
    topology: Topology  #: what the scheduler knew of it
    offline: bool
    process: str  #: of a graph of several; else empty
    started: str  #: wall clock, ISO 8601
    options: Mapping[str, Mapping[str, str]]  #: of each stage, defaults included: seeds are here
    executors: Mapping[
        str, Mapping[str, str]
    ]  #: of each device: its class, what it is, its options
    versions: Mapping[str, str]
    machine: Mapping[str, str]  #: what decides the last bit of a float: CPU, features, threads

    def note(self) -> tuple[str, dict[str, str]]:
        """As a note of the file: its name and its texts."""
        values = {"format": str(FORMAT)}
        for key, value in asdict(self).items():
            values[key] = value if isinstance(value, str) else json.dumps(value)
        return NOTE, values

    @classmethod
    def of(cls, notes: Mapping[str, Mapping[str, str]]) -> Self:
        """The manifest among a file's notes. Raises DataError."""
        note = notes.get(NOTE)
        if note is None:
            raise DataError(
                "holds no recorded run; one is made by `overflight run GRAPH --record FILE`"
            )
        if note.get("format") != str(FORMAT):
            raise DataError(
                f"was recorded in form {note.get('format')}, and this program reads form {FORMAT}; "
                "use the version that recorded it"
            )
        texts = ("graph", "text", "process", "started")
        try:
            values: dict[str, Any] = {key: note[key] for key in texts}
            values["topology"] = _checked(_TOPOLOGY.validate_json(note["topology"]))
            for key in ("offline", "options", "executors", "versions", "machine"):
                values[key] = json.loads(note[key])
        except (KeyError, ValueError, ValidationError) as error:
            raise DataError(
                f"damaged: its description of the run cannot be read ({error})"
            ) from None
        return cls(**values)


def _checked(topology: Topology) -> Topology:
    """The same, once it is sure that a scheduler can be made of it. Raises ValueError."""
    ports = {Port(node.name, name) for node in topology.stages for name in node.outputs}
    names = {node.name for node in topology.stages}
    if len(names) != len(topology.stages) or not 0 < topology.workers < 10_000:
        raise ValueError("two stages have one name, or there are no workers")
    for node in topology.stages:
        triggers = [entry for entry in node.inputs if entry.sync is Sync.TRIGGER]
        if node.inputs and (len(triggers) != 1 or len(triggers[0].sources) != 1):
            raise ValueError(f"{node.name} has not one trigger")
        for entry in node.inputs:
            if not entry.sources or not ports.issuperset(entry.sources):
                raise ValueError(f"{node.name}.{entry.name} comes from nowhere")
    return topology
