"""The graph that the networks' cards are measured with, and what is measured there."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tools.main import app

pytestmark = pytest.mark.slow

GRAPHS = Path(__file__).resolve().parents[2] / "graphs"


def told(*words: str) -> dict[str, object]:
    ran = CliRunner().invoke(app, [*words, "--json"])
    assert ran.exit_code == 0, ran.output
    answer: dict[str, object] = json.loads(ran.stdout)
    return answer


def test_networks_and_truth_are_written_beside_each_other(
    tiny_flight: Path, tmp_path: Path
) -> None:
    words = ["run", str(GRAPHS / "judge_networks.yaml"), "--speed", "max", "--out", str(tmp_path)]
    words += ["--set", f"parameters.flight={tiny_flight}", "--set", "parameters.rate_hz=10"]
    assert CliRunner().invoke(app, words).exit_code == 0
    for name in ("image", "scan"):
        true = tmp_path / f"{name}_truth"
        perfect = told("evaluate", str(true), "--truth", str(true))
        judged = told("evaluate", str(tmp_path / name), "--truth", str(true))
        assert perfect["views"]["all"]["mean_iou"] == 1  # type: ignore[index]
        assert 0.2 < judged["views"]["all"]["mean_iou"] < 1  # type: ignore[index]


def test_a_detector_is_judged_on_a_flight(tiny_flight: Path) -> None:
    words = ("evaluate-detections", "detect-rgb", "--images", str(tiny_flight))
    whole, large = told(*words), told(*words, "--min-side-px", "12")
    assert whole["images"] == large["images"] == 10
    count = [one["classes"]["vehicle"]["objects"] for one in (whole, large)]  # type: ignore[index]
    assert count[0] > count[1] > 0
