from __future__ import annotations

import io
from typing import Any

import pytest
from rich.console import Console

from pipeline.scheduling.events import Reason
from tools.report import WHY, print_report


@pytest.fixture
def report() -> dict[str, Any]:
    return {
        "graph": "uav",
        "wall_s": 15.0,
        "stages": {"detect": {"runs": 200, "errors": 3, "stopped": True}},
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


def printed(report: dict[str, Any]) -> list[str]:
    console = Console(file=io.StringIO(), width=140)
    print_report(report, console)
    assert isinstance(console.file, io.StringIO)
    return [" ".join(line.split()) for line in console.file.getvalue().splitlines()]


def test_each_output_shows_its_rate_and_age(report: dict[str, Any]) -> None:
    assert "rgb/out 450 30.0 Hz 1 ms 3 ms" in printed(report)


def test_what_has_no_meaning_offline_is_a_dash(report: dict[str, Any]) -> None:
    assert "detect/out 230 - - -" in printed(report)


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
