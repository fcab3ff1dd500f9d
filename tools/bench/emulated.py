"""The paper's graph on emulated devices with the paper's latencies, live.

Rates are the report's. The share of same frames compares the stamps that fuse_image is given. What
the process uses apart from its stages is its CPU time less that of the steps of stages that are no
sources: emulated sensors are part of the machinery here, so all of theirs counts as ours.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from accelerators.registry import Registry
from pipeline.drivers.run import run_graph
from pipeline.graph.graph import Graph, load_graph
from pipeline.message import Message, Span
from stages.fuse_image import FuseImage
from stages.fused import FusedImage
from stages.types import ClassScores, DepthImage, Detections, Pose
from tools.bench.harness import Effort, Row
from tools.bench.scheduler import FILE

NETWORKS = ("segment_rgb", "detect_rgb", "detect_thermal")
#: One turn of the three networks on the one Edge TPU takes 40.5 + 17.5 + 12.0 ms.
BOUND_HZ = 1e3 / (40.5 + 17.5 + 12.0)


def measure(effort: Effort) -> list[Row]:
    """The rows of one run."""
    seconds = effort.seconds or effort.of(60, 10)
    catalog = Registry.open()
    graph, agreeing = watched(load_graph(FILE, catalog=catalog))
    result = run_graph(graph, catalog, duration_s=seconds)
    if result.failures:
        raise RuntimeError("; ".join(result.failures))
    ran_s = result.report["wall_s"]
    if ran_s < seconds:  # a signal ends a run early and well, with rates that look right
        raise RuntimeError(f"the run ended after {ran_s} of {seconds} s; its figures do not count")
    return rows(result.report, agreeing)


def watched(graph: Graph) -> tuple[Graph, Counter[bool]]:
    """The graph with a fuse_image that counts whether its segmentation and detection agree."""
    agreeing: Counter[bool] = Counter()

    class WatchedFuseImage(FuseImage):
        def process(
            self,
            scores: Message[ClassScores],
            boxes: Message[Detections] | None = None,
            thermal: Message[Detections] | None = None,
            depth: Message[DepthImage] | None = None,
            trajectory: Span[Pose] = (),
        ) -> FusedImage:
            agreeing[boxes is not None and scores.stamp == boxes.stamp] += 1
            return super().process(scores, boxes, thermal, depth, trajectory)

    stages = tuple(
        replace(stage, cls=WatchedFuseImage) if stage.name == "fuse_image" else stage
        for stage in graph.stages
    )
    return replace(graph, stages=stages), agreeing


def rows(report: Mapping[str, Any], agreeing: Counter[bool]) -> list[Row]:
    """The rows of a report."""
    rates = {name: report["outputs"][f"{name}/out"]["rate_hz"] or 0.0 for name in NETWORKS}
    image, cloud = (report["outputs"][f"{name}/out"] for name in ("fuse_image", "fuse_cloud"))
    voxels = report["outputs"]["semantic_map/out"]
    sets = agreeing.total()
    same = agreeing[True] / sets if sets else 0.0
    own = report["cpu"]["process_cores"] - steps_cores(report)
    ages = {
        name: output["age_from_stamp_ms"]
        for name, output in (("image", image), ("cloud", cloud), ("map", voxels))
    }
    graph = f"the paper's graph on emulated devices, {report['wall_s']:.0f} s"
    balanced = "balanced" if report["ledger_balanced"] else "NOT balanced"
    return [
        Row(
            f"{graph}: the three image networks",
            ">= 14.1 Hz each",
            " / ".join(f"{rate:.3f}" for rate in rates.values()) + " Hz",
            f"device bound: {BOUND_HZ:.2f} Hz; paper: 12.6 Hz",
            " / ".join(f"{rate / BOUND_HZ:.3f}" for rate in rates.values()),
            min(rates.values()) >= 14.1,
            {**rates, "wall_s": report["wall_s"]},
        ),
        Row(
            "segmentation and detection of the same frame",
            "every fused-image set",
            f"{100 * same:.2f} % of {sets:,} sets",
            met=sets > 0 and same == 1.0,
            values={"same": same, "sets": sets},
        ),
        _rate_row("fused image", image["rate_hz"], 14.0, 9.9),
        _rate_row("fused cloud", cloud["rate_hz"], 9.95, 9.0),
        Row(
            "the process, apart from the CPU of its stages",
            "<= 6 % of a core",
            f"{100 * own:.1f} % of a core",
            f"process: {100 * report['cpu']['process_cores']:.1f} %; scheduler: "
            f"{100 * report['cpu']['scheduler_fraction']:.1f} % of it; ledger {balanced}",
            met=own <= 0.06,
            values={"own_cores": own, **report["cpu"]},
        ),
        _cpu_row(report),
        Row(
            "age of the oldest sample at the output",
            "",
            "; ".join(
                f"{name} p50 {age['p50']}, p99 {age['p99']} ms" for name, age in ages.items()
            ),
            values=ages,
        ),
    ]


def _rate_row(name: str, rate: float | None, goal: float, paper: float) -> Row:
    rate = rate or 0.0
    return Row(
        name,
        f">= {goal:g} Hz",
        f"{rate:.3f} Hz",
        f"paper: {paper:g} Hz",
        f"{rate / paper:.2f}",
        rate >= goal,
        {"rate_hz": rate},
    )


def _cpu_row(report: Mapping[str, Any]) -> Row:
    """What a frame costs in each stage."""
    frame_ms = {
        name: sum(stage["cpu_ms"].values())
        for name, stage in report["stages"].items()
        if stage.get("ended", {}).get("finished")
    }
    return Row(
        "CPU of a frame, mean",
        "",
        "; ".join(f"{name} {ms:.1f}" for name, ms in frame_ms.items() if ms >= 0.05) + " ms",
        f"stages together: {100 * steps_cores(report):.0f} % of a core",
        values=frame_ms,
    )


def steps_cores(report: Mapping[str, Any]) -> float:
    """Cores that the steps of all stages but the sources used."""
    used_ms = 0.0
    for stage in report["stages"].values():
        if "ended" in stage:  # a source has no runs that end
            used_ms += sum(stage["cpu_ms"].values()) * stage["runs"]
    return used_ms / 1e3 / float(report["wall_s"])
