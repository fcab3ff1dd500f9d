"""A stream's clock comes out of its stamps and arrivals as it was put in."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.recording.clocks import clock_of


@pytest.mark.parametrize("drift_ppm", [0.0, 40.0, -250.0])
def test_rate_jitter_delay_and_drift_are_found_again(drift_ppm: float) -> None:
    dice = np.random.default_rng(1)
    count, period_ms = 2_000, 50.0
    stamps = 1_000.0 + period_ms * np.arange(count) + dice.uniform(-2, 2, count)
    delays = 7.0 + dice.exponential(3.0, count) + drift_ppm * 1e-6 * stamps
    clock = clock_of(
        "lidar", [round(s * 1e6) for s in stamps], [round(s * 1e6) for s in stamps + delays]
    )
    assert clock.rate_hz == pytest.approx(20.0, rel=1e-3)
    assert clock.period_ms == pytest.approx(50.0, abs=0.2)
    assert clock.jitter_ms == pytest.approx(3.7, abs=0.4)
    assert clock.drift_ppm == pytest.approx(drift_ppm, abs=3)
    assert clock.delay_ms is not None
    assert clock.offset_ms is not None
    assert clock.late_ms is not None
    assert clock.offset_ms < clock.delay_ms < clock.late_ms
    if not drift_ppm:
        assert clock.offset_ms == pytest.approx(7.0, abs=0.1)
        assert clock.delay_ms == pytest.approx(7.0 + 3.0 * np.log(2), abs=0.3)


def test_a_short_stream_tells_no_drift_and_a_single_message_nothing() -> None:
    stamps = [10_000_000 * n for n in range(20)]
    assert clock_of("a", stamps, stamps).drift_ppm is None
    assert clock_of("a", [5], [6]).rate_hz is None
