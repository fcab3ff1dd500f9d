"""Wanted frames: the age of a scan at the fused output, and the inferences that it takes.

The graph is `common_workload.yaml`. `run: every` and `run: wanted` take turns on it, in the forms
that the rows name. The age counts from the scan's stamp until the fused output is there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from accelerators.registry import Registry
from pipeline.drivers.run import run_graph
from pipeline.graph.graph import load_graph
from pipeline.message import Message
from pipeline.model import Tensor, Tensors
from pipeline.stage import ModelStage, Source, Stage, Timing
from tools.bench.harness import Effort, Row

FILE = Path(__file__).with_name("common_workload.yaml")
NETWORKS = ("segment_rgb", "detect_rgb", "detect_thermal")
WANTED = [f"stages.{name}.run=wanted" for name in NETWORKS]
PROMISED = [
    f"stages.{name}.min_period_ms={ms}"
    for name, ms in (("rgb", 33), ("thermal", 111), ("lidar", 100))
]
FREE_RUNNING = ["stages.rgb.options.rate_hz=29.7", "stages.rgb.options.jitter_ms=2"]
STOPPING = ["stages.lidar.options.silent_s=[2, 4]"]
SECOND_CONSUMER = [
    "stages.fuse_image.use=tools.bench.wanted:Pair",
    "stages.fuse_image.inputs.scores=segment_rgb",
    "stages.fuse_image.inputs.boxes={from: detect_rgb, sync: exact}",
]


@dataclass(frozen=True, slots=True)
class Sample:
    """What goes through the graph: nothing but its place in time."""


class Sensor(Source):
    """Samples at an even rate that arrive at their stamps; none within `silent_s`, [from, to]."""

    def __init__(
        self,
        *,
        rate_hz: float,
        phase_ms: float = 0.0,
        jitter_ms: float = 0.0,
        silent_s: tuple[float, float] | None = None,
    ) -> None:
        self._rate_hz = rate_hz
        self._phase_ms = phase_ms
        self._jitter_ms = jitter_ms
        self._silent_s = silent_s or (0.0, 0.0)

    def messages(self) -> Iterator[Message[Sample]]:
        random = np.random.default_rng(0)
        frame = 0
        while True:
            jitter = random.uniform(-self._jitter_ms, self._jitter_ms)
            at_s = frame / self._rate_hz + (self._phase_ms + jitter) / 1e3
            frame += 1
            if not self._silent_s[0] <= at_s < self._silent_s[1]:
                yield Message.at(round(at_s * 1e9), Sample())

    def timing(self) -> Timing:
        return Timing(self._rate_hz, jitter_ms=self._jitter_ms)


class Network(ModelStage):
    """A network whose input and output are nothing: it takes its device's time."""

    def open(self) -> None:
        spec = self.model
        self._input = {spec.input_name: Tensor(np.zeros((1, *spec.input_shape), spec.input_dtype))}

    def prepare(self, sample: Message[Sample]) -> Tensors:
        return self._input

    def finish(self, outputs: Tensors, sample: Message[Sample]) -> Sample:
        return sample.payload


class Fuse(Stage):
    """The fusion of a scan with the nearest of everything else."""

    def process(
        self,
        scan: Message[Sample],
        scores: Message[Sample],
        boxes: Message[Sample],
        thermal: Message[Sample],
    ) -> Sample:
        return scan.payload


class Pair(Stage):
    """A second consumer: it takes every segmentation with the detection of the same frame."""

    def process(self, scores: Message[Sample], boxes: Message[Sample]) -> Sample:
        return scores.payload


def measure(effort: Effort) -> list[Row]:
    """The rows; each form runs for `--seconds`, 20 without."""
    seconds = effort.seconds or effort.of(20, 3)
    rows = []
    for name, settings, asked in (
        ("promised periods", PROMISED, True),
        ("no promise", [], False),
        ("camera at 29.7 Hz, jitter 2 ms, promised", [*PROMISED[1:], *FREE_RUNNING], False),
        ("scans stop for 2 s, promised", [*PROMISED, *STOPPING], False),
        ("fuse_image as a second consumer, promised", [*PROMISED, *SECOND_CONSUMER], False),
    ):
        every = play(settings, seconds)
        wanted = play([*settings, *WANTED], seconds)
        rows.append(_row(name, every, wanted, asked=asked))
    return rows


@dataclass(frozen=True, slots=True)
class Played:
    """What one run of the graph measured."""

    p50_ms: float
    p99_ms: float
    rate_hz: float
    inferences: int  #: of the three image networks
    image_hz: float | None  #: of the second consumer
    missed: int  #: wanted frames that ended without a run


def play(settings: Sequence[str], seconds: float) -> Played:
    """Run the graph once."""
    catalog = Registry.open()
    graph = load_graph(FILE, catalog=catalog, settings=settings)
    result = run_graph(graph, catalog, duration_s=seconds)
    if result.failures:
        raise RuntimeError("; ".join(result.failures))
    report = result.report
    fused = report["outputs"]["fuse/out"]
    age = fused["age_by_stream_ms"]["lidar/out"]
    second = report["outputs"].get("fuse_image/out")
    return Played(
        age["p50"],
        age["p99"],
        fused["rate_hz"],
        sum(report["stages"][name]["runs"] for name in NETWORKS),
        second and second["rate_hz"],
        sum(event.kind == "wish_missed" for event in result.events),
    )


def _row(name: str, every: Played, wanted: Played, *, asked: bool) -> Row:
    saved = 1 - wanted.inferences / every.inferences
    met = wanted.p50_ms <= 78 and wanted.p99_ms <= 95 and wanted.rate_hz >= 8.9 and saved >= 1 / 3
    return Row(
        f"scan stamp to fused output, {name}",
        "p50 <= 78, p99 <= 95 ms at 9.0 Hz, a third fewer inferences" if asked else "",
        _words(wanted) + f", {100 * saved:.0f} % fewer inferences, {wanted.missed} wishes missed",
        f"run: every: {_words(every)}; peers: p50 138-148, p99 170-174 ms",
        f"p50 {wanted.p50_ms / every.p50_ms:.2f}, p99 {wanted.p99_ms / every.p99_ms:.2f}",
        met if asked else None,
        {"wanted": _plain(wanted), "every": _plain(every)},
    )


def _words(played: Played) -> str:
    text = f"p50 {played.p50_ms:.1f}, p99 {played.p99_ms:.1f} ms at {played.rate_hz:.2f} Hz"
    return text if played.image_hz is None else f"{text}, fuse_image {played.image_hz:.2f} Hz"


def _plain(played: Played) -> dict[str, float | None]:
    return {name: getattr(played, name) for name in Played.__slots__}
