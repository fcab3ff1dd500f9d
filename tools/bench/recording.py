"""What recording a flight costs: `--record` on against off, and what one event costs the scheduler.

The graph is the paper's on emulated devices, live, its sensors recorded bit by bit (97 MB/s) and
all outputs hashed. Recorded and not recorded take turns. An offline replay, the same work on both
sides, tells what one event of the scheduler costs more with the tap in it.
"""

from __future__ import annotations

import tempfile
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from accelerators.registry import Registry
from pipeline.drivers.run import run_graph
from pipeline.graph.graph import Graph, load_graph
from pipeline.message import Message
from pipeline.recording.tap import Row as Tapped
from pipeline.recording.tap import TappedScheduler
from pipeline.scheduling.events import Output
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Input, Port, StageNode, Topology
from tools.bench.harness import Effort, Row, interleave, ratio
from tools.bench.scheduler import FILE
from tools.recording.record import RecordOrder, recording


def measure(effort: Effort) -> list[Row]:
    """The rows."""
    seconds = effort.seconds or effort.of(8, 2)
    catalog = Registry.open()
    graph = load_graph(FILE, catalog=catalog)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.mcap"
        run = partial(_run, graph, catalog, seconds, path)
        run(recorded=False)  # loads kernels and fills caches
        sides = {"on": partial(run, recorded=True), "off": partial(run, recorded=False)}
        measured = interleave(sides, effort.of(3, 1))
        size = path.stat().st_size / 1e6 / seconds
    on, off = measured["on"], measured["off"]
    cores = ratio([one["cores"] for one in on], [one["cores"] for one in off])
    writer = median(one["writer"] for one in on)
    lost = sum(one["lost"] for one in on)
    return [
        Row(
            f"a live run with --record, {seconds:g} s of the paper's graph",
            "no message lost",
            f"{median(one['cores'] for one in on):.2f} cores, of them the recorder's thread "
            f"{100 * writer:.0f} % of one; {lost} messages lost; {size:.1f} MB/s written",
            f"without: {median(one['cores'] for one in off):.2f} cores",
            str(cores),
            lost == 0,
            {"writer_cores": writer, "ratio": cores.median, "lost": lost, "written_mb_s": size},
        ),
        Row(
            "age of the fused cloud, p50, recorded and not",
            "",
            f"{median(one['age_ms'] for one in on):.0f} ms",
            f"without: {median(one['age_ms'] for one in off):.0f} ms",
            str(ratio([one["age_ms"] for one in on], [one["age_ms"] for one in off])),
        ),
        _event_row(effort),
    ]


def _run(
    graph: Graph, catalog: Registry, seconds: float, path: Path, *, recorded: bool
) -> dict[str, float]:
    with ExitStack() as stack:
        recorder = None
        if recorded:
            kept = recording(RecordOrder(path, ()), graph, offline=False)
            recorder = stack.enter_context(kept)
        result = run_graph(graph, catalog, duration_s=seconds, recorder=recorder)
    if result.failures:
        raise RuntimeError("; ".join(result.failures))
    report: dict[str, Any] = result.report
    told = report.get("recording", {})
    return {
        "cores": report["cpu"]["process_cores"],
        "writer": told.get("cpu_s", 0.0) / report["wall_s"],
        "lost": sum(told.get("lost_buffer_full", {}).values()),
        "age_ms": report["outputs"]["fuse_cloud/out"]["age_from_stamp_ms"]["p50"],
    }


class _Nobody:
    """Takes the rows and lets them go."""

    def row(self, row: Tapped) -> None:
        pass

    def message(self, port: Port, message: Message[Any]) -> bool:
        return True


def _event_row(effort: Effort) -> Row:
    """A source, a stage and a sink: three events a message."""
    topology = Topology(
        (
            StageNode("source"),
            StageNode("work", (Input("x", (Port("source"),)),)),
            StageNode("sink", (Input("x", (Port("work"),)),), outputs=()),
        )
    )
    messages = effort.of(5_000, 500)

    def event_us(*, tapped: bool) -> float:
        scheduler = TappedScheduler(topology, _Nobody()) if tapped else Scheduler(topology)
        before = time.thread_time_ns()
        for number in range(messages):
            (work,) = scheduler.publish(Port("source"), Message.at(number, None), number)
            (sink,) = scheduler.step_done(work.run, number, (Output(0, None),))
            scheduler.step_done(sink.run, number)
        return (time.thread_time_ns() - before) / 3e3 / messages

    sides = {"on": partial(event_us, tapped=True), "off": partial(event_us, tapped=False)}
    measured = interleave(sides, effort.of(9, 2))
    on, off = (median(each) for each in measured.values())
    return Row(
        "one event of the scheduler with the tap in it",
        "<= 5 us more",
        f"{on:.1f} us",
        f"without: {off:.1f} us",
        str(ratio(measured["on"], measured["off"])),
        on - off <= 5.0,
        {"on_us": on, "off_us": off},
    )
