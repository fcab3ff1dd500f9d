"""The shipped faults over the emulated flight: a device is lost, the fused outputs go on."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import psutil
import pytest
from driving import arrive

from accelerators.registry import Registry
from pipeline.drivers.run import run_graph
from pipeline.drivers.snapshot import Snapshot
from pipeline.graph.graph import load_graph
from pipeline.measuring.trace import Trace
from pipeline.measuring.trace_entries import Published, Told

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

#: None but a hang takes this long, on a busy machine either.
TIMEOUT_MS = 2_000
#: When a flight ends whose story does not: a busy machine takes longer to start a device anew.
AT_MOST_S = 60
NETWORKS = ("segment_rgb", "detect_rgb", "detect_thermal")


def fly(
    root: Path, overlay: str, *settings: str, until: str, times: int = 1, kill: bool = False
) -> Any:
    """The report of a run with the faults of an overlay, at other times; maybe with a kill.

    It ends a second after the Edge TPU's event `until` came for the last of so many `times`.
    """
    catalog = Registry.open()
    timeouts = [f"stages.{name}.timeout_ms={TIMEOUT_MS}" for name in NETWORKS]
    graph = load_graph(
        root / "graphs/emulated_uav.yaml",
        catalog=catalog,
        overlays=[root / "graphs/faults" / overlay],
        settings=[*timeouts, *settings],
    )
    victims: list[int] = []
    over_at_s: list[float] = []

    def tick(snapshot: Snapshot) -> None:
        if kill and not victims and snapshot.outputs["fuse_image/out"].count > 5:
            (child,) = psutil.Process().children()
            victims.append(child.pid)
            child.kill()
        told = [e for e in snapshot.events if e.subject == "edgetpu" and e.kind == until]
        if len(told) >= times and not over_at_s:
            over_at_s.append(snapshot.elapsed_s + 1)
        if over_at_s and snapshot.elapsed_s > over_at_s[0]:
            arrive(signal.SIGINT)

    trace = Trace(1_000_000)
    report = run_graph(graph, catalog, duration_s=AT_MOST_S, progress=tick, trace=trace).report
    assert report["ledger_balanced"]
    assert report["failures"] == []
    assert bool(victims) == kill
    # Without a failover the fused outputs would wait for the device, a second or more.
    assert {"fuse_image", "fuse_cloud"} <= published_while_down(trace)
    assert psutil.Process().children() == []
    return report


def published_while_down(trace: Trace) -> set[str]:
    """The stages that went on while the Edge TPU was lost."""
    down, stages = False, set()
    for entry in trace.entries():
        if isinstance(entry, Told) and entry.subject == "edgetpu":
            down = entry.kind == "device_down" or (down and entry.kind != "device_up")
        elif isinstance(entry, Published) and down:
            stages.add(entry.stage)
    return stages


def story(report: Any) -> list[str]:
    return [e["kind"] for e in report["events"] if e["of"] == "edgetpu"]


def test_a_device_that_dies_and_returns_is_climbed_back_to(root: Path) -> None:
    times = ["devices.edgetpu.faults.dies_at_s=1", "devices.edgetpu.faults.returns_at_s=2.8"]
    report = fly(root, "edgetpu_dies.yaml", *times, until="device_up")
    kinds = story(report)
    assert kinds.index("device_failed") < kinds.index("device_down") < kinds.index("device_up")
    assert kinds.count("device_down") == kinds.count("device_up") == 1


def test_a_device_that_hangs_in_a_process_of_its_own_is_killed_and_started_anew(
    root: Path,
) -> None:
    report = fly(
        root, "edgetpu_hangs.yaml", "devices.edgetpu.faults.hangs_at_s=1", until="device_up"
    )
    kinds = story(report)
    assert kinds.index("device_hung") < kinds.index("device_down") < kinds.index("device_up")


def test_a_device_that_fails_again_and_again_is_left_alone_longer_each_time(root: Path) -> None:
    report = fly(
        root,
        "edgetpu_raises.yaml",
        "devices.edgetpu.faults.raises_every=5",
        until="device_down",
        times=2,
    )
    lost = [e["at_s"] for e in report["events"] if e["kind"] == "device_down"]
    assert len(lost) >= 2
    assert lost[1] - lost[0] > 1


def test_a_killed_device_process_costs_its_run_and_comes_back(root: Path) -> None:
    settings = ["devices.edgetpu.isolate=true", "devices.edgetpu.faults=null"]
    report = fly(root, "edgetpu_dies.yaml", *settings, until="device_up", kill=True)
    assert any("SIGKILL" in e["text"] for e in report["events"])
    assert story(report)[-1] == "device_up"
