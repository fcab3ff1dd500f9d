from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planning import source, stage

from pipeline.drivers.arrivals import arrivals, shared_clocks
from pipeline.measuring.costs import SourceCost
from pipeline.scheduling.topology import Input, Port, StageNode, Sync, Topology

RGB, DEPTH, LIDAR = source("rgb"), source("depth"), source("lidar")
FUSE = StageNode(
    "fuse", (Input("x", (Port("segment"),)), Input("y", (Port("depth"),), sync=Sync.EXACT))
)
TOPOLOGY = Topology((LIDAR, RGB, DEPTH, stage("segment", "rgb"), FUSE))


def stamps(port: str, seed: int = 0, seconds: float = 10.0, **periods: float) -> list[int]:
    rates = {"rgb": 33.3, "depth": 33.3, "lidar": 100.0, **periods}
    sources = {name: SourceCost(period_ms=ms, jitter_ms=1) for name, ms in rates.items()}
    sent = arrivals(TOPOLOGY, sources, seconds, seed)
    return [message.stamp for _, each, message in sent if each.stage == port]


def test_sources_that_an_exact_input_brings_together_share_their_stamps() -> None:
    assert shared_clocks(TOPOLOGY) == {"lidar": "lidar", "rgb": "rgb", "depth": "rgb"}
    assert stamps("rgb") == stamps("depth")
    assert stamps("rgb") != stamps("lidar")


def test_the_same_seed_gives_the_same_streams_and_another_one_others() -> None:
    assert stamps("lidar", seed=3) == stamps("lidar", seed=3)
    assert stamps("lidar", seed=3) != stamps("lidar", seed=4)


@given(
    period_ms=st.floats(2, 500),
    delay_ms=st.floats(0, 500),
    jitter=st.floats(0, 0.4),
    seed=st.integers(0, 1000),
)
def test_messages_come_by_arrival_with_rising_stamps_in_time(
    period_ms: float, delay_ms: float, jitter: float, seed: int
) -> None:
    cost = SourceCost(period_ms=period_ms, delay_ms=delay_ms, jitter_ms=jitter * period_ms)
    sent = list(arrivals(Topology((RGB,)), {"rgb": cost}, 3.0, seed))
    times = [at for at, _, _ in sent]
    stamped = [message.stamp for _, _, message in sent]
    assert times == sorted(times)
    assert all(a < b for a, b in pairwise(stamped))
    assert all(0 <= stamp < 3_000_000_000 for stamp in stamped)
    assert all(
        at - stamp == round(delay_ms * 1e6) for at, stamp in zip(times, stamped, strict=True)
    )
    assert len(sent) == pytest.approx(3000 / period_ms, abs=2)


def test_a_given_phase_is_kept_and_the_clock_then_does_not_slip() -> None:
    cost = SourceCost(period_ms=20, phase_ms=7)
    sent = arrivals(Topology((RGB,)), {"rgb": cost}, 10.0, 0)
    assert [m.stamp for _, _, m in sent] == [7_000_000 + 20_000_000 * k for k in range(500)]


def test_two_free_sensors_of_one_rate_meet_in_all_phases_alike() -> None:
    first, second = stamps("lidar", rgb=100.0, depth=100.0), stamps("rgb", rgb=100.0, depth=100.0)
    nearest = np.searchsorted(second, first[1:-1])
    phases = (np.array(second)[nearest.clip(0, len(second) - 1)] - first[1:-1]) / 1e8 % 1
    counts, _ = np.histogram(phases, 5, (0, 1))
    assert counts.min() >= 0.6 * counts.mean()


def test_a_capture_begins_and_ends_around_its_stamp() -> None:
    cost = SourceCost(period_ms=100, delay_ms=50, extent_ms=50)
    for at, _, message in arrivals(Topology((LIDAR,)), {"lidar": cost}, 1.0, 0):
        assert (message.begin, message.end) == (message.stamp - 50_000_000, at)
