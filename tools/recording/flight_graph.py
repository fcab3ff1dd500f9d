"""The graph of a recorded flight: its own, or another one fed with what it recorded."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from pipeline.errors import DataError
from pipeline.recording.channels import topic_of
from pipeline.recording.flight import Flight
from pipeline.scheduling.topology import Port
from pipeline.transport.schema import class_name
from stages.codecs.registry import PayloadCodecs
from tools.load import open_graph
from tools.recording.several import flight_files, schedules

if TYPE_CHECKING:
    from accelerators.registry import Registry
    from pipeline.graph.graph import Graph


@dataclass(frozen=True, slots=True)
class GraphFiles:
    """A graph file and what is laid over it."""

    path: Path
    settings: Sequence[str] = ()
    overlays: Sequence[Path] = ()
    models: Sequence[Path] = ()
    out: Path = Path("out")

    def open(self, *more: str) -> tuple[Graph, Registry]:
        """The checked graph, with further settings, and its models. Raises GraphError."""
        settings = (*self.settings, *more)
        return open_graph(self.path, settings, self.overlays, self.models, self.out)


@contextmanager
def own_graph(flight: Flight, name: str) -> Iterator[Path]:
    """The graph file that a flight was recorded with, as a file for the time of the block."""
    text = flight.manifest.text
    if not text:
        raise DataError(f"{flight.path}: holds no graph file; name one before it")
    graph = yaml.safe_load(text)
    graph.pop("faults", None)  # its recorded messages have been through them
    with tempfile.TemporaryDirectory(prefix="overflight-") as folder:
        file = Path(folder) / f"{name}.yaml"
        file.write_text(yaml.safe_dump(graph, sort_keys=False, allow_unicode=True))
        yield file


def on_flight(files: GraphFiles, flight: Path) -> tuple[Graph, Registry]:
    """A graph whose sources are the messages of a flight, which may be in several files; `files`
    may name the flight itself. Raises DataError."""
    flights = [Flight(file) for file in flight_files(flight) or [flight]]
    with ExitStack() as stack:
        if files.path == flight:
            path = stack.enter_context(own_graph(flights[0], flights[0].manifest.graph))
            files = replace(files, path=path)
        graph, _ = files.open()
        return files.open(*recorded_sources(graph, flights))


def recorded_sources(graph: Graph, flights: Sequence[Flight]) -> list[str]:
    """Settings that replace each source by what one of the files of a flight holds of it. Raises
    DataError."""
    settings: list[str] = []
    missing: list[str] = []
    for node in graph.topology.stages:
        if not node.is_source:
            continue
        port = Port(node.name, *node.outputs[:1])
        flight = _holder(port, flights)
        if flight is None:
            missing.append(node.name)
            continue
        stage = f"stages.{node.name}"
        settings += [
            f"{stage}.options=null",
            f"{stage}.use=stages.sources.recording:Recording",
            f"{stage}.options.path={json.dumps(str(flight.path.absolute()))}",
            f"{stage}.options.topic={json.dumps(topic_of(port))}",
        ]
        own = [class_name(kind) for kind in _own_payloads(graph, node.name)]
        settings += [f"{stage}.options.payloads={json.dumps(own)}"] if own else []
    if missing:
        paths = ", ".join(str(flight.path) for flight in flights)
        has = ", ".join(dict.fromkeys(str(port) for flight in flights for port in flight.channels))
        raise DataError(
            f"{paths}: nothing recorded of the sources {', '.join(missing)}; there is {has or 0}"
        )
    return settings


def _holder(port: Port, flights: Sequence[Flight]) -> Flight | None:
    """The file with the messages of a port: that of the process that said them, else one in which
    they arrived. Raises DataError where each start of the process left its own."""
    holders = [flight for flight in flights if port in flight.channels]
    said = [flight for flight in holders if schedules(flight.path, port.stage)] or holders
    if len(said) > 1:
        names = " or ".join(str(flight.path) for flight in said)
        raise DataError(
            f"the process of {port.stage} was started anew, and each start has a file of its own; "
            f"name one in place of the flight: {names}"
        )
    return said[0] if said else None


def payload_codecs(graph: Graph) -> PayloadCodecs:
    """The codecs that may read this graph's payloads, its own classes among them."""
    return PayloadCodecs(
        kind for stage in graph.stages for kind in _own_payloads(graph, stage.name)
    )


def _own_payloads(graph: Graph, stage: str) -> Iterator[type]:
    """The dataclasses that a stage declares to say, without the project's own."""
    for port in graph.stage(stage).contract.outputs:
        for kind in port.payload:
            if is_dataclass(kind) and isinstance(kind, type) and not PayloadCodecs.known(kind):
                yield kind


def without_faults(graph: Graph) -> list[str]:
    """Settings that take the declared faults out: a replay re-enacts those that were recorded."""
    return [
        f"devices.{name}.faults=null"
        for name, device in graph.devices.items()
        if device.block.get("faults") is not None
    ]
