"""Two hosts on loopback addresses: one joins late, dies, and comes back."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from flying import Run

from pipeline.transport.zenoh import free_endpoint

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

GRAPH = """\
overflight: 1
graph: hosts
hosts: {{drone: {{listen: ["{endpoint}"]}}, ground: {{}}}}
processes: {{main: {{host: drone}}, station: {{host: ground}}}}
stages:
  camera: {{use: apart_stages:Frames, options: {{rate_hz: 20, pixels: 300000}}}}
  seen:
    use: stages.sinks.count:Count
    process: station
    inputs: {{message: {{from: camera, rate_hz: 10, compress: zstd}}}}
"""


@pytest.fixture
def hosts(tmp_path: Path) -> Iterator[list[Run]]:
    (tmp_path / "apart.yaml").write_text(GRAPH.format(endpoint=free_endpoint()))
    runs: list[Run] = []
    yield runs
    for run in runs:
        run.close()


def sees(page: dict[str, Any]) -> bool:
    return bool(page["edges"].get("camera/out->seen/message", {}).get("delivered", 0) >= 5)


def test_a_ground_station_joins_late_dies_and_comes_back_while_the_drone_flies_on(
    hosts: list[Run], tmp_path: Path
) -> None:
    drone = Run(tmp_path, "--host", "drone", watched="drone")
    hosts.append(drone)
    drone.until(lambda page: bool(page["outputs"]["camera/out"]["count"] >= 5))
    for ending in (signal.SIGKILL, signal.SIGINT):
        ground = Run(tmp_path, "--host", "ground", watched="ground")
        hosts.append(ground)
        page = ground.until(sees)
        book = page["edges"]["camera/out->seen/message"]
        assert book["produced"] == book["delivered"] + book["in_flight"] + sum(
            book["dropped"].values()
        )
        os.kill(ground.process.pid, ending)
        ground.process.communicate(timeout=30)
    os.kill(drone.process.pid, signal.SIGINT)
    report = drone.report()
    assert report["ledger_balanced"]
    camera = report["outputs"]["camera/out"]
    assert camera["longest_gap_ms"] < 2_000  # nothing of it held the drone back (generous)
    sent = report["edges"]["camera/out->seen/message"]
    assert sent["produced"] == sent["delivered"] + sum(sent["dropped"].values())
