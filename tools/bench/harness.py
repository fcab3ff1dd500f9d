"""What every benchmark shares: rounds in shuffled order, medians and p99, ratios, table rows."""

from __future__ import annotations

import contextlib
import gc
import random
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any, TypeVar

from pipeline.drivers.live import SWITCH_INTERVAL_S

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Effort:
    """How long to measure."""

    quick: bool = False  #: a smoke test: every row, no figure to rely on
    seconds: float | None = None  #: of the benchmarks that run a graph; None: their own choice

    def of(self, full: int, quick: int) -> int:
        """A count of rounds or messages."""
        return quick if self.quick else full


@dataclass(frozen=True, slots=True)
class Row:
    """One line of BENCHMARK.md."""

    figure: str
    goal: str
    measured: str
    beside: str = ""  #: the floor or peer of the same run
    ratio: str = ""
    met: bool | None = None  #: None where there is no goal
    values: Mapping[str, Any] = field(default_factory=dict)  #: the plain numbers, for --json


@dataclass(frozen=True, slots=True)
class Ratio:
    """Ours over theirs, round by round: the median decides, the extremes say how noisy it was."""

    median: float
    least: float
    greatest: float

    def __str__(self) -> str:
        return f"{self.median:.2f} ({self.least:.2f}-{self.greatest:.2f})"


def ratio(ours: Sequence[float], theirs: Sequence[float]) -> Ratio:
    """The ratios of two sides that were measured in the same rounds."""
    each = sorted(a / b for a, b in zip(ours, theirs, strict=True))
    return Ratio(median(each), each[0], each[-1])


def interleave(sides: Mapping[str, Callable[[], T]], rounds: int) -> dict[str, list[T]]:
    """Measure every side once a round, in an order shuffled anew for each round.

    A machine that slows down for a while then slows all sides, and none by its place in the order.
    """
    shuffle = random.Random(1).shuffle
    measured: dict[str, list[T]] = {name: [] for name in sides}
    for _ in range(rounds):
        names = list(sides)
        shuffle(names)
        for name in names:
            measured[name].append(sides[name]())
    return measured


def quantile(values: Sequence[float], fraction: float) -> float:
    """The nearest-rank quantile."""
    ordered = sorted(values)
    return ordered[min(int(fraction * len(ordered)), len(ordered) - 1)]


@dataclass(frozen=True, slots=True)
class Latency:
    """Latencies in us, one list per round."""

    rounds: Sequence[Sequence[float]]

    @property
    def p50(self) -> list[float]:
        return [quantile(values, 0.50) for values in self.rounds]

    @property
    def p99(self) -> list[float]:
        return [quantile(values, 0.99) for values in self.rounds]

    def __str__(self) -> str:
        return f"p50 {median(self.p50):.1f}, p99 {median(self.p99):.1f} us"


def latency_row(
    figure: str,
    ours: Latency,
    theirs: Latency,
    peer: str,
    *,
    p50: float,
    p99: float | None = None,
    hold: bool = True,
) -> Row:
    """Ours beside theirs, with goals as ratios; `hold` False: the ratios are shown, not asked."""
    half, tail = ratio(ours.p50, theirs.p50), ratio(ours.p99, theirs.p99)
    goal = f"p50 <= {p50} x" + (f", p99 <= {p99} x" if p99 is not None else "")
    met = half.median <= p50 and (p99 is None or tail.median <= p99)
    values = {
        "p50_us": median(ours.p50),
        "p99_us": median(ours.p99),
        "peer_p50_us": median(theirs.p50),
        "peer_p99_us": median(theirs.p99),
        "p50_ratio": half.median,
        "p99_ratio": tail.median,
        "samples": sum(map(len, ours.rounds)),
    }
    return Row(
        figure,
        goal if hold else "",
        str(ours),
        f"{peer}: {theirs}",
        f"p50 {half}, p99 {tail}",
        met if hold else None,
        values,
    )


def paced(count: int, period_s: float) -> Iterator[int]:
    """Beats 0, 1, 2 ..., each handed out when it is due: the pacing of both sides."""
    never = threading.Event()
    start = time.monotonic()
    for beat in range(count):
        while (wait := start + beat * period_s - time.monotonic()) > 0:
            never.wait(wait)
        yield beat


@contextlib.contextmanager
def live_settings() -> Iterator[None]:
    """The interpreter as the live driver sets it, so that a floor does not differ by it."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        gc.enable()
        gc.unfreeze()


@contextlib.contextmanager
def busy_python(busy: bool = True) -> Iterator[None]:
    """A thread that never gives up the GIL on its own, as a stage in pure Python holds it."""
    over = threading.Event()

    def spin() -> None:
        total = 0
        while not over.is_set():
            for number in range(1000):
                total += number * number

    thread = threading.Thread(target=spin, daemon=True)
    if busy:
        thread.start()
    try:
        yield
    finally:
        over.set()
        if busy:
            thread.join()
