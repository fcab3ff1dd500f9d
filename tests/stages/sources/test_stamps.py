from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stages.sources.stamps import Stamps


@given(
    rate_hz=st.floats(0.5, 500),
    part=st.floats(0, 0.98),
    offset_ms=st.floats(-1000, 1000),
    seed=st.integers(0, 9),
)
def test_jitter_never_reorders_frames_and_stays_within_its_bounds(
    rate_hz: float, part: float, offset_ms: float, seed: int
) -> None:
    jitter_ms = part * 500 / rate_hz
    stamps = Stamps(rate_hz, offset_ms, jitter_ms, seed=seed)
    found = [stamp for _, stamp in stamps.of(range(50))]
    assert found == sorted(set(found))
    for frame, stamp in enumerate(found):
        nominal = frame * 1e9 / rate_hz + offset_ms * 1e6
        assert abs(stamp - nominal) <= jitter_ms * 1e6 + 1
    assert found == [stamp for _, stamp in stamps.of(range(50))]


def test_another_seed_gives_another_jitter() -> None:
    one, two = (list(Stamps(10, jitter_ms=5, seed=seed).of(range(9))) for seed in (1, 2))
    assert one != two


def test_a_sample_arrives_after_its_delay_and_never_before_its_capture_ends() -> None:
    stamps = Stamps(10, delay_ms=20)
    assert stamps.arrival(100) == 20_000_100
    assert stamps.arrival(100, end=50_000_000) == 50_000_000


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"rate_hz": 0.0}, "rate_hz must be above 0"),
        ({"rate_hz": 10.0, "jitter_ms": 50.0}, r"below half a period \(50 ms\)"),
        ({"rate_hz": 10.0, "delay_ms": -1.0}, "delay_ms must not be negative"),
    ],
)
def test_a_bad_option_is_refused(options: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Stamps(**options)
