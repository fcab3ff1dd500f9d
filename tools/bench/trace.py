"""What watching a run costs: `--trace` on against off, and the page that `overflight top` reads.

The graph is the paper's on emulated devices. Trace on and off take turns on the same work, an
offline run over the same samples, so that only the recording differs in CPU time. The page is
measured in a live run, where it is all that the profiler counts as progress display.
"""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from statistics import median

from accelerators.registry import Registry
from pipeline.drivers.run import RunResult, run_graph
from pipeline.graph.graph import Graph, load_graph
from pipeline.measuring.board import Board
from pipeline.measuring.trace import Trace
from tools.bench.harness import Effort, Row, interleave, ratio
from tools.bench.scheduler import FILE


def measure(effort: Effort) -> list[Row]:
    """The rows."""
    graph_s, rounds = effort.of(2, 1), effort.of(9, 2)
    catalog = Registry.open()
    graph = load_graph(FILE, catalog=catalog)
    entries: list[int] = []

    def cpu_s(*, traced: bool) -> float:
        trace = Trace() if traced else None
        result = run_graph(graph, catalog, speed=None, duration_s=graph_s, trace=trace)
        if trace is not None:
            entries.append(trace.recorded)
        return _cpu_s(result)

    cpu_s(traced=True)  # loads kernels and fills caches
    sides = {"on": partial(cpu_s, traced=True), "off": partial(cpu_s, traced=False)}
    measured = interleave(sides, rounds)
    on, off = (median(each) for each in measured.values())
    cost = ratio(measured["on"], measured["off"])
    return [
        Row(
            f"a run with --trace, {graph_s} s of the graph",
            "<= 2 % more CPU",
            f"{on:.3f} s of CPU, {entries[-1]:,} entries",
            f"without: {off:.3f} s",
            str(cost),
            cost.median <= 1.02,
            {"on_s": on, "off_s": off, "ratio": cost.median, "entries": entries[-1]},
        ),
        _page_row(graph, catalog, effort.seconds or effort.of(20, 2)),
    ]


def _page_row(graph: Graph, catalog: Registry, seconds: float) -> Row:
    with tempfile.TemporaryDirectory() as folder, Board(Path(folder)) as board:
        result = run_graph(graph, catalog, duration_s=seconds, board=board)
    _cpu_s(result)
    cores = result.report["cpu"]["parts_cores"]["progress display"]
    return Row(
        "the page of `overflight top`, put up twice a second",
        "<= 0.5 % of a core",
        f"{100 * cores:.2f} % of a core",
        f"process: {100 * result.report['cpu']['process_cores']:.1f} %",
        met=cores <= 0.005,
        values={"cores": cores},
    )


def _cpu_s(result: RunResult) -> float:
    """CPU time of the process; raises where the run is no measurement."""
    if result.failures or result.ended.startswith("signal"):
        raise RuntimeError("; ".join(result.failures) or f"the run ended early: {result.ended}")
    return float(result.report["cpu"]["process_cores"]) * float(result.report["wall_s"])
