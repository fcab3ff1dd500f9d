"""Two hosts, on loopback addresses and in network namespaces: one joins late, dies, comes back."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from flying import Run
from namespaces import ENDPOINT, Namespaces, NotAllowed

from pipeline.transport.zenoh import Reserved

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
    inputs: {{message: {{from: camera, rate_hz: 10, compress: {compress}}}}}
"""

#: Starts the part of a host.
Start = Callable[[str], Run]


def starter(folder: Path, runs: list[Run], endpoint: str, compress: str, *before: Any) -> Start:
    (folder / "apart.yaml").write_text(GRAPH.format(endpoint=endpoint, compress=compress))
    prefix = dict(zip(("drone", "ground"), before, strict=False))

    def start(host: str) -> Run:
        runs.append(Run(folder, "--host", host, watched=host, before=prefix.get(host, ())))
        return runs[-1]

    return start


@pytest.fixture
def runs() -> Iterator[list[Run]]:
    started: list[Run] = []
    yield started
    for run in started:
        run.close()


@pytest.fixture
def namespaces() -> Iterator[Namespaces]:
    try:
        with Namespaces() as made:
            yield made
    except NotAllowed as why:
        pytest.skip(f"no network namespaces: {why}")


def sees(page: dict[str, Any], least: int = 5) -> bool:
    return bool(page["edges"].get("camera/out->seen/message", {}).get("delivered", 0) >= least)


def balances(book: dict[str, Any]) -> bool:
    ended = book["delivered"] + sum(book["dropped"].values())
    return bool(book["produced"] == ended + book.get("in_flight", 0))


def assert_a_ground_station_comes_and_goes(start: Start) -> None:
    drone = start("drone")
    drone.until(lambda page: bool(page["outputs"]["camera/out"]["count"] >= 5))
    for ending in (signal.SIGKILL, signal.SIGINT):
        ground = start("ground")
        page = ground.until(sees)
        assert balances(page["edges"]["camera/out->seen/message"])
        os.kill(ground.process.pid, ending)
        ground.process.communicate(timeout=60)
    os.kill(drone.process.pid, signal.SIGINT)
    report = drone.report()
    assert report["ledger_balanced"]
    camera = report["outputs"]["camera/out"]
    assert camera["longest_gap_ms"] < 5_000  # nothing of it held the drone back (generous)
    assert balances(report["edges"]["camera/out->seen/message"])


def test_a_ground_station_joins_late_dies_and_comes_back_while_the_drone_flies_on(
    runs: list[Run], tmp_path: Path
) -> None:
    with Reserved() as reserved:
        start = starter(tmp_path, runs, reserved.endpoint, "zstd")
        assert_a_ground_station_comes_and_goes(start)


def test_a_host_says_whom_it_waits_for(runs: list[Run], tmp_path: Path) -> None:
    with Reserved() as reserved:
        ground = starter(tmp_path, runs, reserved.endpoint, "zstd")("ground")
        page = ground.until(lambda page: bool(page["events"]))
    told = {event["kind"]: event for event in page["events"]}["waiting"]
    assert (told["at_s"], told["of"]) == (0, "host drone")


def test_so_it_does_between_two_network_namespaces(
    runs: list[Run], tmp_path: Path, namespaces: Namespaces
) -> None:
    start = starter(tmp_path, runs, ENDPOINT, "zstd", *namespaces.commands)
    assert_a_ground_station_comes_and_goes(start)


def test_a_slow_cable_that_is_pulled_for_a_while_loses_messages_and_never_holds_the_drone_back(
    runs: list[Run], tmp_path: Path, namespaces: Namespaces
) -> None:
    try:
        namespaces.slow("8mbit")  # a third of what the edge has to say
    except NotAllowed as why:
        pytest.skip(f"no slow cable: {why}")
    start = starter(tmp_path, runs, ENDPOINT, "null", *namespaces.commands)
    drone, ground = start("drone"), start("ground")
    ground.until(sees)
    namespaces.plug(namespaces.names[1], "down")
    before = drone.page()["outputs"]["camera/out"]["count"]
    drone.until(lambda page: bool(page["outputs"]["camera/out"]["count"] >= before + 40))
    seen = ground.page()["edges"]["camera/out->seen/message"]["delivered"]
    namespaces.plug(namespaces.names[1], "up")
    ground.until(lambda page: sees(page, seen + 5))
    for run in (ground, drone):
        os.kill(run.process.pid, signal.SIGINT)
    report = ground.report()
    assert report["ledger_balanced"]
    arrived = report["outputs"]["camera/out"]
    assert arrived["age_from_stamp_ms"]["p50"] < 3_000  # the latest, not what came first
    [book] = report["edges"].values()
    assert book["dropped"]["lost_in_transport"] >= 15  # of the pulled cable alone
    report = drone.report()
    assert report["ledger_balanced"]
    assert report["outputs"]["camera/out"]["longest_gap_ms"] < 5_000
