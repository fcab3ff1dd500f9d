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
from pipeline.recording.mcap import MAGIC
from pipeline.scheduling.topology import Port
from stages.codecs.registry import PayloadCodecs
from tools.load import open_graph

if TYPE_CHECKING:
    from accelerators.registry import Registry
    from pipeline.graph.graph import Graph


def is_flight(path: Path) -> bool:
    """Whether a file is a recording, whatever it is called."""
    try:
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


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


def on_flight(files: GraphFiles, flight: Flight) -> tuple[Graph, Registry]:
    """A graph whose sources are the messages of a flight; `files` may name the flight itself."""
    with ExitStack() as stack:
        if files.path == flight.path:
            path = stack.enter_context(own_graph(flight, flight.manifest.graph))
            files = replace(files, path=path)
        graph, _ = files.open()
        return files.open(*recorded_sources(graph, flight))


def recorded_sources(graph: Graph, flight: Flight) -> list[str]:
    """Settings that replace each source by what the flight recorded of it. Raises DataError."""
    settings: list[str] = []
    missing: list[str] = []
    for node in graph.topology.stages:
        if not node.is_source:
            continue
        port = Port(node.name, *node.outputs[:1])
        if port not in flight.channels:
            missing.append(node.name)
            continue
        stage = f"stages.{node.name}"
        settings += [
            f"{stage}.options=null",
            f"{stage}.use=stages.sources.recording:Recording",
            f"{stage}.options.path={json.dumps(str(flight.path.absolute()))}",
            f"{stage}.options.topic={json.dumps(topic_of(port))}",
        ]
    if missing:
        has = ", ".join(str(port) for port in flight.channels)
        raise DataError(
            f"{flight.path}: holds nothing of the sources {', '.join(missing)}; it has {has or 0}"
        )
    return settings


def payload_codecs(graph: Graph) -> PayloadCodecs:
    """The codecs that may read this graph's payloads, its own classes among them."""
    declared = {
        kind
        for stage in graph.stages
        for port in stage.contract.outputs
        for kind in port.payload
        if is_dataclass(kind) and isinstance(kind, type)
    }
    return PayloadCodecs(declared)


def without_faults(graph: Graph) -> list[str]:
    """Settings that take the declared faults out: a replay re-enacts those that were recorded."""
    return [
        f"devices.{name}.faults=null"
        for name, device in graph.devices.items()
        if device.block.get("faults") is not None
    ]
