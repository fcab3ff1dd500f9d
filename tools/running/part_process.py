"""The process of one part of a graph: what the supervisor of `overflight run` starts.

Run as ``python -m tools.running.part_process DESCRIPTOR PARENT NAME``.
"""

from __future__ import annotations

import contextlib
import gc
import os
import socket
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.transport.child_end import end_with

if TYPE_CHECKING:
    from pipeline.graph.catalog import Catalog
    from pipeline.graph.graph import Graph
    from pipeline.recording.recorder import Recorder

#: What the supervisor runs with ``python -m``.
MODULE = "tools.running.part_process"


def load(header: Mapping[str, Any]) -> tuple[Graph, Catalog]:
    """The graph that `tools.running.apart.opening` describes."""
    from tools.load import open_graph

    return open_graph(
        Path(header["graph"]),
        header["settings"],
        [Path(overlay) for overlay in header["overlays"]],
        [Path(file) for file in header["models"]],
        Path(header["out"]),
    )


@contextlib.contextmanager
def record(header: Mapping[str, Any], graph: Graph) -> Iterator[Recorder | None]:
    """A recorder where `opening` asked for one; after a restart it begins another file, with what
    the start before left."""
    asked = header["record"]
    if asked is None:
        yield None
        return
    from pipeline.graph.run_folder import run_folder
    from pipeline.recording.left_behind import keep
    from tools.recording.record import SOURCES, RecordOrder, recording
    from tools.running.apart import recorded

    own = {f"{node.name}/{name}" for node in graph.topology.stages for name in node.outputs}
    path = recorded(Path(asked["path"]), header["process"])
    if header["life"] > 1:
        path = recorded(path, str(header["life"]))
    edges = (SOURCES, *(edge for edge in asked["edges"] if edge in own))
    order = RecordOrder(path, edges, asked["compression"])
    with recording(order, graph, offline=False, process=header["process"]) as recorder:
        if header["life"] > 1 and graph.written is not None:
            keep(recorder.file, run_folder(graph.written.out))
        yield recorder


def main() -> None:
    """Be the part on the descriptor in the arguments, until it ends or the parent is gone."""
    descriptor, parent = int(sys.argv[1]), int(sys.argv[2])
    os.setpgid(0, 0)  # Ctrl-C is the supervisor's to hand on
    if not end_with(parent):
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # What opening makes stays: looking for garbage in it is a tenth of the CPU until the graph goes
    # on. From then on the driver says when.
    gc.disable()
    from pipeline.processes.part import serve_part
    from pipeline.transport.mailbox import Mailbox

    sys.exit(serve_part(Mailbox(socket.socket(fileno=descriptor)), load, record))


if __name__ == "__main__":
    main()
