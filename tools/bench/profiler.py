"""What the profiler costs, and whether it tells the truth of real networks.

The cost is the CPU of the paper's emulated graph with it and without: without it no clock of a
thread or a pool is read at a step and none is booked. The truth about a network on a pool of two
threads is the clock of a process of its own, alone (which copies tensors in and out, too, a few
percent of these small networks); beside it stands what the profiler says when three such networks
run in one process. Rounds are short and shuffled.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median

from accelerators.registry import Registry
from pipeline.drivers.run import run_graph
from pipeline.errors import OverflightError
from pipeline.graph.graph import Graph, load_graph
from pipeline.measuring.profiler import Profiler, Reading, Spent
from pipeline.scheduling.events import Step
from tools.bench.harness import Effort, Row, interleave, ratio
from tools.bench.scheduler import FILE
from tools.profiling.profile_variants import alone

NETWORKS = Path(__file__).parent / "networks.yaml"

NOT_READ = Reading(None, 0, 0, 0)
NOTHING = Spent(0, 0)


class Off(Profiler):
    """Reads no clock for a step and books none."""

    def read(self, device: str | None = None) -> Reading:
        return NOT_READ

    def since(self, before: Reading) -> Spent:
        return NOTHING

    def book(self, stage: str, step: Step, device: str | None, spent: Spent) -> None:
        """Keeps nothing."""


class Timed(Profiler):
    """Adds up what its own calls at a step take, where they are made: with cold caches, too."""

    def __init__(self) -> None:
        super().__init__()
        self.took_ns = 0
        self._adding = threading.Lock()

    def read(self, device: str | None = None) -> Reading:
        before = time.thread_time_ns()
        reading = super().read(device)
        self._add(before)
        return reading

    def since(self, before: Reading) -> Spent:
        began = time.thread_time_ns()
        spent = super().since(before)
        self._add(began)
        return spent

    def book(self, stage: str, step: Step, device: str | None, spent: Spent) -> None:
        before = time.thread_time_ns()
        super().book(stage, step, device, spent)
        self._add(before)

    def _add(self, before_ns: int) -> None:
        took = time.thread_time_ns() - before_ns
        with self._adding:
            self.took_ns += took


def measure(effort: Effort) -> list[Row]:
    """The rows of the cost, and one per network."""
    seconds, rounds = effort.of(2, 1), effort.of(9, 2)
    measured = interleave(
        {"on": partial(cpu_s, Profiler, seconds), "off": partial(cpu_s, Off, seconds)}, rounds
    )
    more = ratio(measured["on"], measured["off"])
    on, off = (median(measured[side]) for side in ("on", "off"))
    return [
        Row(
            f"CPU of {seconds} s of the paper's emulated graph, every frame, profiler on over off",
            "<= 1.02",
            f"{on:.3f} s",
            f"off: {off:.3f} s",
            str(more),
            more.median <= 1.02,
            {"on_s": measured["on"], "off_s": measured["off"], "ratio": more.median},
        ),
        cost_of_its_calls(seconds, effort.of(5, 1)),
        cost_of_a_step(effort),
        *networks(effort),
    ]


def cost_of_its_calls(seconds: float, rounds: int) -> Row:
    """The same cost, told apart from the noise of two runs: what the calls took within a run."""
    shares, took_ms = [], []
    for _ in range(rounds):
        timed = Timed()
        whole = cpu_s(lambda: timed, seconds)  # noqa: B023 (called at once)
        took_ms.append(timed.took_ns / 1e6)
        shares.append(timed.took_ns / 1e9 / whole)
    return Row(
        f"of those {seconds} s, in the calls at each step, timed where they are made",
        "<= 2 %",
        f"{median(took_ms):.1f} ms",
        "",
        f"{100 * median(shares):.2f} %",
        median(shares) <= 0.02,
        {"took_ms": took_ms, "shares": shares},
    )


def cpu_s(profiler: Callable[[], Profiler], seconds: float) -> float:
    """CPU time of the process from the first message to the last; offline, so that every run does
    the same work, whatever else the machine does."""
    catalog = Registry.open()
    graph = load_graph(FILE, catalog=catalog)
    read: list[float] = []

    def note(_: object) -> None:
        read.append(time.process_time())

    result = run_graph(
        graph, catalog, speed=None, duration_s=seconds, progress=note, profiler=profiler()
    )
    if result.failures:
        raise RuntimeError("; ".join(result.failures))
    return read[-1] - read[0]


def cost_of_a_step(effort: Effort) -> Row:
    """What reading and booking one step takes, in a loop."""
    profiler, count = Profiler(), effort.of(100_000, 5_000)
    began = time.thread_time()
    for _ in range(count):
        profiler.book("a", Step.PROCESS, None, profiler.since(profiler.read()))
    us = (time.thread_time() - began) / count * 1e6
    figure = "reading the clocks around one step and booking it"
    return Row(figure, "", f"{us:.2f} us", values={"us": us})


def networks(effort: Effort) -> list[Row]:
    """One row per network: CPU of an infer by the profiler, over that of a process of its own."""
    try:
        catalog = Registry.open()
        graph = load_graph(NETWORKS, catalog=catalog)
        apart = load_graph(
            NETWORKS,
            catalog=catalog,
            settings=[f"devices.{name}.isolate=true" for name in graph.devices],
        )
    except OverflightError:
        return [Row("networks in one process", "", "not measured: needs their files")]
    seconds, rounds = effort.of(5, 1), effort.of(5, 1)
    stages = [stage.name for stage in graph.stages if stage.model]
    sides = {stage: partial(infer_ms, alone(apart, stage), catalog, seconds) for stage in stages}
    measured = interleave({"together": partial(infer_ms, graph, catalog, seconds), **sides}, rounds)
    rows = []
    for stage in stages:
        told = [figures[stage] for figures in measured["together"]]
        truth = [figures[stage] for figures in measured[stage]]
        off = ratio(told, truth)
        rows.append(
            Row(
                f"CPU of an infer beside two other networks, {stage}",
                "0.9 to 1.1",
                f"{median(told):.2f} ms",
                f"alone, clock of its process: {median(truth):.2f} ms",
                str(off),
                0.9 <= off.median <= 1.1,
                {"told_ms": told, "truth_ms": truth},
            )
        )
    return rows


def infer_ms(graph: Graph, catalog: Registry, seconds: float) -> dict[str, float]:
    """Mean CPU time of an infer by stage, without what carries data to a process of its own."""
    report = run_graph(graph, catalog, duration_s=seconds).report
    return {
        name: cost["infer"]["cpu_ms"]["mean"] - cost["infer"].get("transfer_ms", 0.0)
        for name, stage in report["stages"].items()
        for cost in stage["steps"].values()
        if "infer" in cost
    }
