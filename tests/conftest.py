"""Fixtures that every test may use."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# The same examples on every machine, so that a change is judged and not a draw; no deadline and no
# complaint of slow examples, since the first one compiles kernels and a machine may be busy: what
# hangs, pytest's timeout ends. New examples: --hypothesis-profile=default, for the scheduler =deep.
settings.register_profile(
    "steady",
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("steady")

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def root() -> Path:
    """The project's folder."""
    return ROOT


@pytest.fixture(scope="session")
def shared() -> Path:
    """Recordings and public networks beside the project; tests that need them skip without."""
    folder = ROOT.parent / "shared"
    if not (folder / "data").is_dir():
        pytest.skip("needs the recordings in ../shared, which are not part of the project")
    return folder
