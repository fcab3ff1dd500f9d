"""The kernels of fusion and map, on one thread, beside the time that memory alone would take.

A figure is the thread's CPU time per call, in shuffled rounds. The bound is what a call cannot
avoid to read and write, over the bandwidth of a copy of an image of probabilities (24 MB read, 24
written) in the same rounds. That no other thread computed meanwhile is a row of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from statistics import median
from time import process_time_ns, thread_time_ns

import numpy as np

from tools.bench.harness import Effort, Row, interleave, live_settings, quantile
from tools.bench.kernel_cases import (
    PROBABILITIES,
    Case,
    Flight,
    cluster_cases,
    map_cases,
    points_cases,
    range_cases,
)
from tools.bench.kernel_scene import frames

#: Seconds until the stages of fusion and map are open, imports and all.
START = """
from time import perf_counter
started = perf_counter()
from tools.bench.kernel_cases import fusion_stages
imported = perf_counter()
fusion_stages()
print(imported - started, perf_counter() - imported)
"""


def measure(effort: Effort) -> list[Row]:
    """The rows."""
    scene = frames(4)
    maps, bytes_per_voxel = map_cases(scene, 100_000, effort.of(5_000_000, 200_000))
    cases = [*points_cases(scene), *cluster_cases(scene), *maps, *range_cases(scene)]
    seen = 2 * PROBABILITIES  # the past read, the present written
    cases += [
        Case("image path, scores of 107 x 61 int8", Flight(scene, 8).image_path, 18, seen),
        Case(
            "image path, scores of 848 x 480 float32",
            Flight(scene, 1).image_path,
            moved=seen + PROBABILITIES * 16 / 15,
        ),
        Case("whole fusion with map, per frame", Flight(scene, 8).frame, 36),
    ]
    present, past = np.ones((2, PROBABILITIES), dtype=np.uint8)
    cases.append(Case("copy", partial(np.copyto, present, past)))
    for case in cases:
        for _ in range(3):
            case.call()
    calls, rounds = effort.of(20, 2), effort.of(9, 2)
    before = process_time_ns(), thread_time_ns()
    with live_settings():
        sides = {case.figure: partial(times_ms, case.call, calls) for case in cases}
        measured = interleave(sides, rounds)
    process_ns, thread_ns = process_time_ns() - before[0], thread_time_ns() - before[1]
    times = {figure: [ms for each in rounds for ms in each] for figure, rounds in measured.items()}
    bandwidth = 2 * PROBABILITIES / median(times.pop("copy")) / 1e6
    return [
        *(row(case, times[case.figure], bandwidth) for case in cases[:-1]),
        Row(
            "bytes per voxel of the largest map, infinite horizon",
            "<= 140",
            f"{bytes_per_voxel:.0f}",
            met=bytes_per_voxel <= 140,
            values={"bytes": bytes_per_voxel},
        ),
        Row(
            "CPU of other threads while kernels ran",
            "none",
            f"{100 * (process_ns / thread_ns - 1):.1f} % of the measuring thread's",
            met=process_ns < 1.01 * thread_ns,
            values={"process_ms": process_ns / 1e6, "thread_ms": thread_ns / 1e6},
        ),
        *start_rows(effort),
    ]


def times_ms(call: Callable[[], object], calls: int) -> list[float]:
    """CPU time of each call, ms."""
    times = []
    for _ in range(calls):
        started = thread_time_ns()
        call()
        times.append((thread_time_ns() - started) / 1e6)
    return times


def row(case: Case, times: list[float], bandwidth: float) -> Row:
    """A case's line; `bandwidth` in GB/s."""
    p50, p99 = median(times), quantile(times, 0.99)
    bound = case.moved / bandwidth / 1e6
    return Row(
        case.figure,
        "" if case.goal_ms is None else f"<= {case.goal_ms:g} ms",
        f"p50 {p50:.2f}, p99 {p99:.2f} ms",
        f"memory at {bandwidth:.0f} GB/s: {bound:.2f} ms" if bound else "",
        f"{p50 / bound:.1f}" if bound else "",
        None if case.goal_ms is None else p50 <= case.goal_ms,
        {"p50_ms": p50, "p99_ms": p99, "bound_ms": bound, "gb_per_s": bandwidth},
    )


def start_rows(effort: Effort) -> Iterator[Row]:
    """Opening the stages in own processes: compiling (not when quick), then from the cache."""
    with tempfile.TemporaryDirectory() as cache:
        own = {**os.environ, "NUMBA_CACHE_DIR": cache}
        if not effort.quick:
            _, first = _start(own)
            yield Row("stages opened, first run", "", f"{first:.1f} s", values={"s": first})
        else:
            own = dict(os.environ)
        runs = [_start(own) for _ in range(effort.of(5, 1))]
    imports, opening = (median(each) for each in zip(*runs, strict=True))
    yield Row(
        "stages opened, kernels from the cache",
        "< 1 s",
        f"{opening:.2f} s",
        f"imports before it: {imports:.2f} s",
        met=opening < 1.0,
        values={"s": opening, "imports_s": imports},
    )


def _start(environment: dict[str, str]) -> tuple[float, float]:
    words = [sys.executable, "-c", START]
    run = subprocess.run(words, check=True, capture_output=True, text=True, env=environment)
    imports, opening = map(float, run.stdout.split())
    return imports, opening
