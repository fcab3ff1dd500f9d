"""`overflight run --record`: what of a graph's run goes into the file."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import cv2
import typer

from pipeline.graph.graph import Graph, GraphStage
from pipeline.recording.manifest import Manifest
from pipeline.recording.mcap import Compression
from pipeline.recording.recorder import Recorder
from pipeline.scheduling.topology import Port
from stages.codecs.registry import PayloadCodecs
from stages.sources.recording import write_calibration
from stages.types import Calibration
from tools.bench.machine import cpu_model
from tools.versions import versions

#: Words that stand for edges.
SOURCES, ALL = "sources", "all"


@dataclass(frozen=True, slots=True)
class RecordOrder:
    """A recording of a run, as a person asks for it."""

    path: Path
    edges: Sequence[str]  #: whose messages are written; none: those of the sources
    compression: Compression = "lz4"


@contextmanager
def recording(
    order: RecordOrder, graph: Graph, *, offline: bool, process: str = ""
) -> Iterator[Recorder]:
    """A recorder for one run of a graph, or of the part of a `process`."""
    stored = chosen(graph, order.edges or (SOURCES,))
    recorder = Recorder(
        order.path,
        manifest_of(graph, offline=offline, process=process),
        PayloadCodecs(),
        stored=stored,
        sources=_sources(graph),
        compression=order.compression,
    )
    with recorder:
        calibration = _calibration(graph)
        if calibration is not None:
            write_calibration(recorder.file, calibration)
        yield recorder


def chosen(graph: Graph, words: Sequence[str]) -> frozenset[Port]:
    """The output ports that `--record-edges` names. Raises BadParameter for what is none."""
    ports = [Port(node.name, name) for node in graph.topology.stages for name in node.outputs]
    known = {ALL: ports, SOURCES: _sources(graph)}
    for port in ports:
        known.setdefault(port.stage, []).append(port)
        known[str(port)] = [port]
    found: set[Port] = set()
    for word in (part.strip() for text in words for part in text.split(",")):
        if word not in known:
            close = get_close_matches(word, known, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"there are {', '.join(known)}"
            raise typer.BadParameter(f"--record-edges: no output '{word}' in the graph; {hint}")
        found.update(known[word])
    return frozenset(found)


def manifest_of(graph: Graph, *, offline: bool, process: str = "") -> Manifest:
    """What a recording says of this graph, this machine and these versions."""
    out = "" if graph.written is None else str(graph.written.out)
    return Manifest(
        graph=graph.name,
        text="" if graph.written is None else graph.written.text(),
        topology=graph.topology,
        offline=offline,
        process=process,
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        options={stage.name: _options(stage, out) for stage in graph.stages},
        executors={
            name: {"use": device.use, **_said(device.options)}
            for name, device in graph.devices.items()
        },
        versions={name: version for name, version in versions().items() if version},
        machine=machine(),
    )


def machine() -> Mapping[str, str]:
    """What decides the last bit of a float, beside the versions."""
    return {
        "cpu": cpu_model(),
        "features": " ".join(sorted(_cpu_flags())),
        "threads_opencv": str(cv2.getNumThreads()),
        "threads_blas": os.environ.get("OPENBLAS_NUM_THREADS", "unset"),
    }


def _cpu_flags() -> set[str]:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        key, _, value = line.partition(":")
        if key.strip() in ("flags", "Features"):
            return set(value.split())
    return set()


def _options(stage: GraphStage, out: str) -> dict[str, str]:
    """Every option of a stage, also those that the file leaves at their default, seeds among them;
    the output folder by its word."""
    defaults = {
        option.name: option.default for option in stage.contract.options if not option.required
    }
    said = _said({**defaults, **stage.options})
    for name, value in stage.options.items():
        if out and isinstance(value, Path):
            said[name] = said[name].replace(out, "$out")
    return said


def _said(options: Mapping[str, Any]) -> dict[str, str]:
    """Options as text: values by what they are, objects by their class."""
    said = {name: repr(value) for name, value in options.items()}
    for name, value in options.items():
        if isinstance(value, Calibration) or f" object at {hex(id(value))}" in said[name]:
            said[name] = f"{type(value).__module__}:{type(value).__qualname__}"
    return said


def _sources(graph: Graph) -> list[Port]:
    nodes = (node for node in graph.topology.stages if node.is_source)
    return [Port(node.name, name) for node in nodes for name in node.outputs]


def _calibration(graph: Graph) -> Calibration | None:
    for stage in graph.stages:
        for value in stage.options.values():
            if isinstance(value, Calibration):
                return value
    return None
