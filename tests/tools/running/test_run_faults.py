"""`overflight run` of a graph whose faults kill a process and cut a link, for real."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from flying import TWO_PROCESSES, Run

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

OVERLAY = """\
faults:
  sources: {camera: {repeats_at_s: 0.31}}
  links: {camera: {cut_at_s: 0.5, restored_at_s: 1.2}, work: {delay_ms: 20}}
  processes: {far: {killed_at_s: [3.6]}}
"""


def test_a_run_survives_its_faults_tells_of_each_and_its_ledger_balances(tmp_path: Path) -> None:
    (tmp_path / "apart.yaml").write_text(TWO_PROCESSES)
    (tmp_path / "faults.yaml").write_text(OVERLAY)
    run = Run(tmp_path, "--overlay", "faults.yaml")
    try:
        page = run.until(lambda page: page["processes"].get("far", {}).get("restarts") == 1)
        worked = page["outputs"]["work/out"]["count"]
        assert worked  # before it was killed
        run.until(lambda page: bool(page["outputs"]["work/out"]["count"] > worked + 5))
        os.kill(run.process.pid, signal.SIGINT)
        report = run.report()
    finally:
        run.close()
    faults = [
        (event["of"], event["text"]) for event in report["events"] if event["kind"] == "fault"
    ]
    assert faults == [
        ("work/out", "its link is slow by 20 ms, as its faults say"),
        ("camera", "repeats its last message, as its faults say"),
        ("camera/out", "its link is cut, as its faults say"),
        ("camera/out", "its link is restored"),
        ("far", "is killed, as its faults say"),
    ]
    assert report["refused"] == {"camera/out": {"backward": 1}}
    assert report["ledger_balanced"]
    assert report["processes"]["far"]["restarts"] == 1
    # Of 0.7 s of the cut at 20 Hz, and of what the killed process was not there for: a camera that
    # is late on a busy machine loses less in one of them.
    lost = report["edges"]["camera/out->work/other"]["dropped"]["lost_in_transport"]
    assert lost >= 5
    kept = report["edges"]["work/out->kept/message"]
    assert kept["produced"] == kept["delivered"] + sum(kept["dropped"].values())


def test_a_cut_alone_is_lost_in_transport_to_the_message(tmp_path: Path) -> None:
    """Nobody is killed, so both ends' books are there: they agree on every message."""
    (tmp_path / "apart.yaml").write_text(TWO_PROCESSES)
    (tmp_path / "faults.yaml").write_text(
        "faults: {links: {camera: {cut_at_s: 0.5, restored_at_s: 3.0}}}"
    )
    counts = ["--set", "stages.camera.options.count=100", "--set", "stages.lidar.options.count=50"]
    run = Run(tmp_path, "--overlay", "faults.yaml", *counts)
    try:
        report = run.report()
    finally:
        run.close()
    assert report["ended"] == "sources ended"
    assert report["ledger_balanced"]
    link = report["links"]["camera/out to far"]
    assert link["sent"] == 100
    assert link["received"] + link["lost"] == 100
    # 2.5 s at 20 Hz are 50; a camera that stands still for a while on a busy machine sends its
    # frames after the cut.
    assert 10 <= link["lost"] <= 90
    dropped = report["edges"]["camera/out->work/other"]["dropped"]
    assert dropped["lost_in_transport"] == link["lost"]
    assert report["outputs"]["work/out"]["count"] == 50
