from __future__ import annotations

import io
from typing import Any

import pytest
from rich.console import Console

from pipeline.scheduling.events import Reason
from tools.watching.report import WHY, _beside_stages, print_report


@pytest.fixture
def report() -> dict[str, Any]:
    return {
        "graph": "uav",
        "wall_s": 15.0,
        "ended": "duration",
        "stages": {
            "rgb": {"runs": 450, "errors": 0, "stopped": False, "cpu_ms": {"process": 0.02}},
            "detect": {
                "runs": 200,
                "errors": 3,
                "stopped": True,
                "cpu_ms": {"prepare": 1.25, "infer": 0.5, "finish": 2.0},
            },
        },
        "edges": {
            "rgb/out->detect/image": {
                "produced": 450,
                "delivered": 230,
                "reused": 0,
                "dropped": {"replaced": 219, "end": 0},
                "in_flight": 1,
            }
        },
        "ledger_balanced": True,
        "devices": {
            "edgetpu": {
                "runs": 200,
                "busy_fraction": 0.512,
                "wait_ms": {"p50": 1.0, "p99": 20.0},
                "up": False,
                "is": "emulated",
                "stages": {
                    "detect": {
                        "runs": 200,
                        "busy_fraction": 0.512,
                        "wait_ms": {"p50": 1.0, "p99": 20.0},
                    }
                },
            }
        },
        "events": [
            {"at_s": 3.02, "kind": "device_down", "of": "edgetpu", "text": "is lost; a reason"},
            {"at_s": 4.0, "kind": "stale", "of": "x", "text": "not of a device"},
        ],
        "outputs": {
            "rgb/out": {
                "count": 450,
                "rate_hz": 30.0,
                "age_from_stamp_ms": {"p50": 1.2, "p99": 3.4},
                "age_from_arrival_ms": None,
            },
            "detect/out": {
                "count": 230,
                "rate_hz": None,
                "age_from_stamp_ms": None,
                "age_from_arrival_ms": None,
            },
        },
    }


def test_devices_show_their_load_their_stages_and_their_story(report: dict[str, Any]) -> None:
    lines = printed(report)
    assert "edgetpu: emulated (lost) 200 51.2 % 1.0 ms 20.0 ms" in lines
    assert "detect 200 51.2 % 1.0 ms 20.0 ms" in lines
    assert "3.02 s edgetpu is lost; a reason" in lines
    assert not any("not of a device" in line for line in lines)


def printed(report: dict[str, Any]) -> list[str]:
    console = Console(file=io.StringIO(), width=140)
    print_report(report, console)
    assert isinstance(console.file, io.StringIO)
    return [" ".join(line.split()) for line in console.file.getvalue().splitlines()]


def test_each_output_shows_its_rate_and_age(report: dict[str, Any]) -> None:
    assert "rgb/out 450 30.0 Hz 1 ms 3 ms" in printed(report)


def test_what_has_no_meaning_offline_is_a_dash(report: dict[str, Any]) -> None:
    assert "detect/out 230 - - -" in printed(report)


def test_each_stage_shows_the_cpu_time_of_a_run_and_of_its_steps(report: dict[str, Any]) -> None:
    lines = printed(report)
    assert "detect 200 3.75 ms 1.25 0.50 2.00 5.0 %" in lines
    assert "rgb 450 0.02 ms 0.1 %" in lines


def test_a_loss_shows_its_edge_its_share_and_the_reason_in_words(report: dict[str, Any]) -> None:
    lines = printed(report)
    assert "detect/image rgb 450 230 219 replaced" in lines
    assert f"replaced: {WHY['replaced']}" in lines


def test_reasons_that_did_not_occur_are_left_out(report: dict[str, Any]) -> None:
    assert not [line for line in printed(report) if WHY["end"] in line]


def test_failed_runs_are_named(report: dict[str, Any]) -> None:
    assert "detect: 3 of 200 runs failed, and it stopped" in printed(report)


def test_an_unbalanced_ledger_is_said_aloud(report: dict[str, Any]) -> None:
    assert not [line for line in printed(report) if "does not balance" in line]
    assert [line for line in printed(report | {"ledger_balanced": False}) if "not balance" in line]


def test_every_reason_of_the_ledger_is_explained() -> None:
    assert set(WHY) == set(Reason)


def test_what_the_process_takes_beside_its_stages_is_said() -> None:
    parts = {"scheduler": 0.023, "unattributed": 0.0001}
    cpu = {"process_cores": 0.54, "parts_cores": parts}
    said = _beside_stages(cpu)
    assert "scheduler 2.3 %, unattributed 0.0 %" in said
    assert "the process in all 54.0 % of a core" in said
    assert _beside_stages({"process_cores": 0.54}) == ""  # a plan does not know


def test_what_a_recording_lacks_is_said(report: dict[str, Any]) -> None:
    whole = {
        "path": "out/f.mcap",
        "lost_buffer_full": {},
        "lost_no_codec": {},
        "decisions_lost": 0,
        "ended_early": None,
    }
    assert printed(report | {"recording": whole}) == printed(report)
    late = whole | {"lost_buffer_full": {"rgb/out": 3, "lidar/out": 9}, "decisions_lost": 2}
    mapping = {"restarts": 0, "cpu_cores": 0.1, "recording": late}
    said = " ".join(printed(report | {"processes": {"mapping": mapping}}))
    assert "out/f.mcap lacks 12 messages or hashes (9 lidar/out, 3 rgb/out) and 2 decisions" in said
    full = whole | {"ended_early": "No space left on device", "lost_no_codec": {"map/out": 5}}
    said = " ".join(printed(report | {"recording": full}))
    assert "f.mcap ended before the run: No space left on device" in said
    assert "no messages of map/out" in said
