"""One synchronizer: events a second, time per decision, and how near the chosen messages are.

Events are the messages of all streams in the order of their arrival: a LiDAR at 10 Hz (the trigger,
50 ms late), a free-running camera at 29.97 Hz, detections with the trigger's stamps, poses at
100 Hz; all stamps jittered. A decision is everything from a trigger's arrival to its set: judge,
take, prune. The baseline is our own reading of the idea behind ROS's ApproximateTimeSynchronizer,
not its code.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from random import Random
from statistics import fmean, median
from time import perf_counter, perf_counter_ns
from typing import Any

from pipeline.message import Message
from pipeline.scheduling.sync import Synchronizer, WaitingSet
from pipeline.scheduling.topology import Input, Port, Sync
from tools.bench.approximate_time import ApproximateTime
from tools.bench.harness import Effort, Latency, Row, interleave, quantile, ratio

MS = 1_000_000
TOLERANCE_MS = 50
GOAL_HZ = 300_000
GOAL_US = 10


@dataclass(frozen=True, slots=True)
class Stream:
    """A sensor: nominal rate, uniform jitter of its stamps, arrival delay after the stamp."""

    rate_hz: float
    jitter_ms: float
    delay_ms: float
    seed: int

    def messages(self, seconds: float) -> Iterator[Message[None]]:
        random = Random(self.seed)
        for number in range(1, int(seconds * self.rate_hz)):
            jitter_ms = random.uniform(-self.jitter_ms, self.jitter_ms)
            stamp = int((number * 1e3 / self.rate_hz + jitter_ms) * MS)
            yield Message.at(stamp, None, received=stamp + int(self.delay_ms * MS))


LIDAR = Stream(10, 2, 50, seed=1)
CAMERA = Stream(29.97, 5, 5, seed=2)
NETWORK = Stream(29.97, 5, 75, seed=2)  #: the same frames after a network: later than the scan
DETECTIONS = Stream(10, 2, 80, seed=1)  #: the LiDAR's seed and jitter: the very same stamps
POSES = Stream(100, 1, 2, seed=3)

TRIGGER = Input("scan", (Port("lidar"),))
NEAREST = Input("image", (Port("camera"),), Sync.NEAREST, tolerance=TOLERANCE_MS * MS)
EXACT = Input("boxes", (Port("detections"),), Sync.EXACT)
SPAN = Input("trajectory", (Port("poses"),), Sync.SPAN)

Events = Sequence[tuple[int, Message[None]]]  #: by arrival: (stream, message); 0 is the trigger


def measure(effort: Effort) -> list[Row]:
    """The rows: throughput, decisions, gaps."""
    seconds, rounds = effort.of(600, 20), effort.of(9, 2)
    pair = by_arrival([LIDAR, CAMERA], seconds)
    graphs: dict[str, tuple[list[Input], Events]] = {
        "nearest": ([TRIGGER, NEAREST], pair),
        "nearest, exact and span": (
            [TRIGGER, NEAREST, EXACT, SPAN],
            by_arrival([LIDAR, CAMERA, DETECTIONS, POSES], seconds),
        ),
    }
    sides: dict[str, Callable[[], float]] = {
        name: partial(events_hz, rules, events) for name, (rules, events) in graphs.items()
    }
    sides["baseline"] = partial(baseline_hz, pair)
    rates = interleave(sides, rounds)
    baseline = median(rates["baseline"])
    return [
        *(
            Row(
                f"one synchronizer, offline, {name}",
                f">= {GOAL_HZ:,} events/s",
                f"{median(rates[name]):,.0f} events/s",
                f"approximate time, two topics: {baseline:,.0f} events/s",
                str(ratio(rates[name], rates["baseline"])),
                median(rates[name]) >= GOAL_HZ,
                {"events_hz": median(rates[name]), "baseline_hz": baseline},
            )
            for name in graphs
        ),
        *decision_rows(effort),
        gap_row("frames that come before the scan", pair),
        gap_row("frames that come after it", by_arrival([LIDAR, NETWORK], seconds)),
    ]


def by_arrival(streams: Sequence[Stream], seconds: float) -> Events:
    """The messages of all streams as they arrive."""
    arriving = [(i, m) for i, stream in enumerate(streams) for m in stream.messages(seconds)]
    return sorted(arriving, key=lambda event: (event[1].received, event[0]))


def play(synchronizer: Synchronizer, events: Events) -> Iterator[tuple[Any, ...]]:
    """The values of every set, as the scheduler asks for them."""
    waiting = synchronizer.waiting
    for stream, message in events:
        now = message.received
        if stream:
            if not synchronizer.offer(synchronizer.slots[stream - 1], message, now):
                continue
        else:
            least = message.stamp + 1
            entry = WaitingSet(message, now)
            synchronizer.arrived(entry)
            synchronizer.open(entry)
        while synchronizer.ready(now):
            inputs, _ = synchronizer.take()
            for slot in synchronizer.slots:
                for index in synchronizer.chosen(slot):
                    slot.used[index] = True
            synchronizer.lower(waiting[0].stamp if waiting else least)
            yield inputs.values


def events_hz(rules: Sequence[Input], events: Events) -> float:
    """Messages a second through one synchronizer; raises where it forms too few sets."""
    synchronizer = Synchronizer(rules, offline=True)
    started = perf_counter()
    sets = sum(1 for _ in play(synchronizer, events))
    seconds = perf_counter() - started
    triggers = sum(not stream for stream, _ in events)
    if sets < 0.9 * triggers:
        raise RuntimeError(f"{sets} sets of {triggers} triggers; the measurement says nothing")
    return len(events) / seconds


def decision_rows(effort: Effort) -> list[Row]:
    """Time per decision with few and with many messages held."""
    count, rounds = effort.of(1000, 50), effort.of(9, 2)
    sides: dict[str, Callable[[], list[float]]] = {
        f"{rule.sync}, {queued:,} queued": partial(decisions, rule, queued, count)
        # Spans keep a second behind every trigger: a hundred poses, so there is no row for 10.
        for rule, queued in ((NEAREST, 10), (NEAREST, 1000), (SPAN, 1000))
    }
    measured = interleave(sides, rounds)
    rows = []
    for name, each in measured.items():
        latency = Latency(each)
        p50 = median(latency.p50)
        values = {"p50_us": p50, "p99_us": median(latency.p99)}
        goal = f"<= {GOAL_US} us"
        rows.append(
            Row(f"a decision, {name}", goal, str(latency), met=p50 <= GOAL_US, values=values)
        )
    return rows


def decisions(rule: Input, queued: int, count: int) -> list[float]:
    """Times of decisions with `queued` messages held ahead of every trigger, us."""
    synchronizer = Synchronizer([TRIGGER, rule], offline=True)
    (slot,) = synchronizer.slots
    ahead = iter((CAMERA if rule.sync is Sync.NEAREST else POSES).messages(1e9))
    times: list[float] = []
    for trigger in LIDAR.messages((count + 20) / LIDAR.rate_hz):
        while len(slot) < queued or slot.stamps[-1] < trigger.stamp + TOLERANCE_MS * MS:
            synchronizer.offer(slot, next(ahead), 0)
        started = perf_counter_ns()
        entry = WaitingSet(trigger, trigger.received)
        synchronizer.arrived(entry)
        synchronizer.open(entry)
        if not synchronizer.ready(trigger.received):
            raise RuntimeError("a set that has all it needs is not ready")
        synchronizer.take()
        for index in synchronizer.chosen(slot):
            slot.used[index] = True
        synchronizer.lower(trigger.stamp + 1)
        times.append((perf_counter_ns() - started) / 1e3)
    return times


def baseline_hz(events: Events) -> float:
    """Messages a second through the baseline."""
    baseline = ApproximateTime(2, TOLERANCE_MS * MS)
    started = perf_counter()
    for stream, message in events:
        baseline.add(stream, message.stamp)
    return len(events) / (perf_counter() - started)


def nearest_ms(frames: Sequence[int], stamp: int) -> float:
    """The gap to the nearest frame of a whole recording."""
    after = bisect_left(frames, stamp)
    return min(abs(stamp - frame) for frame in frames[max(after - 1, 0) : after + 1]) / MS


def gap_row(which: str, events: Events) -> Row:
    """How far the chosen camera frame is from its scan, ours and the baseline's, and the least."""
    triggers = [message.stamp for stream, message in events if not stream]
    frames = sorted(message.stamp for stream, message in events if stream)
    synchronizer = Synchronizer([TRIGGER, NEAREST], offline=True)
    ours = [abs(scan.stamp - image.stamp) / MS for scan, image in play(synchronizer, events)]
    baseline = ApproximateTime(2, TOLERANCE_MS * MS)
    sets = [found for stream, message in events if (found := baseline.add(stream, message.stamp))]
    theirs = [abs(scan - image) / MS for scan, image in sets]
    least = [nearest_ms(frames, stamp) for stamp in triggers[: len(ours)]]
    best = fmean(least)
    return Row(
        f"mean gap of a scan to its frame, {which}",
        "the optimum",
        f"{fmean(ours):.3f} ms in {len(ours):,} sets",
        f"optimum: {best:.3f} ms; approximate time: {fmean(theirs):.3f} ms in {len(theirs):,} sets",
        f"ours {fmean(ours) / best:.3f}, approximate time {fmean(theirs) / best:.2f}",
        ours == least,
        {
            "gap_ms": fmean(ours),
            "optimum_ms": best,
            "baseline_ms": fmean(theirs),
            "greatest_ms": max(ours),
            "p99_ms": quantile(ours, 0.99),
        },
    )
