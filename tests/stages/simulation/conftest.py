"""The tiny flight, built once for all tests of the simulation."""

from __future__ import annotations

import pytest

from stages.simulation.simulation import Sample, Simulation
from stages.simulation.specification import load_preset


@pytest.fixture(scope="session")
def tiny() -> Simulation:
    return Simulation(*load_preset("tiny"))


@pytest.fixture(scope="session")
def samples(tiny: Simulation) -> list[Sample]:
    """Every sample of the tiny flight, in the order of arrival."""
    return [sample for turn in tiny.exposures() for sample in tiny.take(turn)]
