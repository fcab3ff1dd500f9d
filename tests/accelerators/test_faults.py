from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from accelerators.faults import Fault, Faults, FaultSchedule


def fates(faults: Faults, at: list[float], seed: int = 0) -> list[Fault | None]:
    schedule = FaultSchedule(faults, seed)
    return [schedule.next_run(second) for second in at]


def test_a_device_is_dead_from_its_death_to_its_return() -> None:
    found = fates(Faults(dies_at_s=3, returns_at_s=6), [0, 2.9, 3, 5.9, 6, 60])
    assert found == [None, None, Fault.DEAD, Fault.DEAD, None, None]


def test_a_device_that_does_not_return_stays_dead() -> None:
    assert fates(Faults(dies_at_s=3), [3, 1e6]) == [Fault.DEAD, Fault.DEAD]


def test_one_run_hangs_the_first_when_it_is_due() -> None:
    assert fates(Faults(hangs_at_s=2), [1, 2.5, 3]) == [None, Fault.HANGS, None]


def test_every_nth_run_raises() -> None:
    found = fates(Faults(raises_every=5), [0.0] * 15)
    assert [number for number, fault in enumerate(found, 1) if fault] == [5, 10, 15]


def test_a_flapping_device_does_it_all_again() -> None:
    faults = Faults(dies_at_s=1, returns_at_s=2, hangs_at_s=3, repeat_s=4)
    found = fates(faults, [0, 1, 2, 3, 3.5, 4, 5, 6, 7])
    D, H = Fault.DEAD, Fault.HANGS
    assert found == [None, D, None, H, None, None, D, None, H]


@given(st.integers(0, 99), st.floats(0.1, 0.9))
def test_the_same_seed_fails_the_same_runs_whatever_dies_between(seed: int, share: float) -> None:
    runs = [0.0] * 60
    plain = fates(Faults(raise_probability=share), runs, seed)
    assert plain == fates(Faults(raise_probability=share), runs, seed)
    dying = fates(Faults(raise_probability=share, dies_at_s=1, returns_at_s=2), [1.0] * 30, seed)
    assert set(dying) == {Fault.DEAD}
    later = Faults(raise_probability=share, dies_at_s=1, returns_at_s=2)
    assert fates(later, [1.0] * 30 + [2.0] * 30, seed)[30:] == plain[30:]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"returns_at_s": 6}, "returns_at_s has to follow a dies_at_s"),
        ({"dies_at_s": 6, "returns_at_s": 6}, "returns_at_s has to follow a dies_at_s"),
        ({"hangs_for_s": 1}, "hangs_for_s needs a hangs_at_s"),
        ({"hangs_at_s": 5, "repeat_s": 5}, "repeat_s has to be longer"),
        ({"raises_every": 0}, "raises_every"),
        ({"raise_probability": 2}, "raise_probability"),
        ({"dies_at": 3}, "dies_at"),
        ({"dies_at_s": -1}, "dies_at_s"),
    ],
)
def test_faults_that_cannot_be_are_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        Faults(**wrong)
