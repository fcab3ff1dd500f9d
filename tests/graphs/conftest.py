"""A flight for the graphs that want one."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.simulate import simulate_file


@pytest.fixture(scope="session")
def tiny_flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four scans and five images of each camera, at a quarter of the sensors' resolution."""
    path = tmp_path_factory.mktemp("flight") / "tiny.mcap"
    simulate_file("tiny", path, as_json=True)
    return path
