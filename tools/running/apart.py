"""A graph in several processes: whether it is one, and what each needs to know."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from pipeline.graph.graph import Graph
from pipeline.graph.placing import HERE
from tools.recording.flight_graph import GraphFiles
from tools.recording.record import SOURCES, RecordOrder, chosen


def runs_apart(graph: Graph, host: str | None, *, alone: bool) -> bool:
    """Whether this command starts several processes, or some of several hosts'.

    `alone`: offline, and when a flight is replayed, all stages share one process; results do not
    depend on where they run. Raises BadParameter where --host does not fit.
    """
    hosts = dict.fromkeys(process.host for process in graph.processes.values())
    if host is not None and host not in hosts:
        if HERE in hosts:
            raise typer.BadParameter(f"--host {host}: no process of this graph names a host")
        raise typer.BadParameter(f"--host {host}: the graph's hosts are {', '.join(hosts)}")
    if host is None and len(hosts) > 1 and not alone:
        raise typer.BadParameter(
            f"this graph runs on {len(hosts)} hosts; say which one this is: "
            + " or ".join(f"--host {name}" for name in hosts)
        )
    return not alone and (len(graph.placement.processes(host)) > 1 or host is not None)


def opening(
    files: GraphFiles, record: Mapping[str, Any] | None, trace: Mapping[str, Any] | None
) -> dict[str, Any]:
    """What a part needs to load the graph, and to `record` and `trace` what it does, as JSON
    values."""
    return {
        "graph": str(files.path),
        "settings": list(files.settings),
        "overlays": list(map(str, files.overlays)),
        "models": list(map(str, files.models)),
        "out": str(files.out),
        "record": record,
        "trace": trace,
    }


def record_asked(graph: Graph, order: RecordOrder) -> dict[str, Any]:
    """What `opening` says of a recording. Raises BadParameter for an edge that is none."""
    ports = map(str, chosen(graph, order.edges or (SOURCES,)))
    return {"path": str(order.path), "edges": sorted(ports), "compression": order.compression}


def recorded(path: Path, process: str) -> Path:
    """The recording of one process: ``flight.mcap`` becomes ``flight.mapping.mcap``."""
    return path.with_name(f"{path.stem}.{process}{path.suffix}")
