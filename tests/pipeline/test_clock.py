from __future__ import annotations

import pytest

from pipeline.clock import ManualClock, ScaledClock


def test_a_manual_clock_moves_only_when_told_and_only_forward() -> None:
    clock = ManualClock(5)
    assert clock.now() == 5
    clock.advance_to(9)
    assert clock.now() == 9
    with pytest.raises(ValueError, match="cannot run backward from 9 to 8"):
        clock.advance_to(8)


def test_a_scaled_clock_begins_at_its_origin_and_runs_at_its_speed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = [100]
    monkeypatch.setattr("time.monotonic_ns", lambda: real[0])
    clock = ScaledClock(1_000, speed=2.0)
    real[0] += 50
    assert clock.now() == 1_100
    assert clock.seconds_until(1_100 + 2_000_000_000) == 1.0
    clock.start()
    assert clock.now() == 1_000


def test_a_clock_cannot_stand_still() -> None:
    with pytest.raises(ValueError, match="speed must be above 0"):
        ScaledClock(0, speed=0.0)
