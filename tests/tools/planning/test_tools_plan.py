"""The command `overflight plan`, on the shipped graph with the shipped costs."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.drivers.plan import run_plan
from pipeline.measuring.costs import read_costs
from tools.load import open_graph

GRAPHS = Path(__file__).resolve().parents[3] / "graphs"
UAV = GRAPHS / "emulated_uav.yaml"
COSTS = GRAPHS / "plan" / "paper_costs.yaml"
NETWORKS = ("segment_rgb/out", "detect_rgb/out", "detect_thermal/out")


def paper(overlay: str, seconds: float = 20.0) -> dict[str, Any]:
    graph, _ = open_graph(UAV, overlays=[GRAPHS / "profile" / overlay])
    return run_plan(graph, read_costs(COSTS), seconds=seconds).report


@pytest.mark.slow
def test_the_papers_costs_give_the_papers_rate_and_load_of_three_image_networks() -> None:
    report = paper("image_networks.yaml")
    rates = [report["outputs"][name]["rate_hz"] for name in NETWORKS]
    assert rates == pytest.approx([12.6] * 3, rel=0.01)
    assert report["cpu"]["process_cores"] == pytest.approx(0.60, rel=0.03)


@pytest.mark.slow
def test_the_papers_costs_give_its_rate_with_image_fusion_at_almost_twice_the_load() -> None:
    report = paper("image_fusion.yaml")
    assert report["outputs"]["fuse_image/out"]["rate_hz"] == pytest.approx(9.9, rel=0.01)
    assert 1.8 * 0.6 <= report["cpu"]["process_cores"] < 2.0 * 0.6


@pytest.mark.slow
def test_the_papers_costs_give_about_9_hz_and_2_cores_with_everything() -> None:
    report = paper("everything.yaml")
    assert report["outputs"]["fuse_cloud/out"]["rate_hz"] == pytest.approx(9.0, rel=0.02)
    assert report["cpu"]["process_cores"] == pytest.approx(2.0, rel=0.05)


def test_table_1_alone_bounds_the_three_image_networks_at_14_28_hz(
    overflight: Callable[..., Any],
) -> None:
    networks = GRAPHS / "profile" / "image_networks.yaml"
    answer = overflight("plan", UAV, "--overlay", networks, "--seconds", 10, "--json")
    assert answer.code == 0, answer.err
    page = json.loads(answer.out)
    own = next(option for option in page["ranking"] if option["is_files"])
    for name in NETWORKS:
        assert own["report"]["outputs"][name]["rate_hz"] == pytest.approx(1e3 / 70, rel=0.005)
    assert "edgetpu" in own["bottleneck"]
    assert any("taken to cost no CPU: segment_rgb" in note for note in page["notes"])


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    """Every assignment of the whole graph, by the command."""
    from typer.testing import CliRunner

    from tools.main import app

    words = ["plan", str(UAV), "--costs", str(COSTS), "--seconds", "5", "--json"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    found: dict[str, Any] = json.loads(result.stdout)
    return found


def test_every_assignment_that_can_run_is_predicted(page: dict[str, Any]) -> None:
    # Three image networks on either device; that of the LiDAR has a time on one alone.
    assert page["assignments"] == 8
    assert page["skipped"] == 0
    assigned = {tuple(option["devices"].items()) for option in page["ranking"]}
    assert len(assigned) == 8
    assert {option["devices"]["segment_scan"] for option in page["ranking"]} == {"igpu"}
    assert sum(option["is_files"] for option in page["ranking"]) == 1


def test_an_assignment_that_starves_an_output_does_not_win(page: dict[str, Any]) -> None:
    rates = [o["report"]["outputs"]["semantic_map/out"]["rate_hz"] for o in page["ranking"]]
    assert rates[0]
    assert None in rates, "with the image networks, which go first, scans get no turn on the iGPU"


def test_demands_come_before_everything_else(
    overflight: Callable[..., Any], page: dict[str, Any]
) -> None:
    assert page["ranking"][0]["report"]["cpu"]["process_cores"] > 2.1
    words = ("plan", UAV, "--costs", COSTS, "--seconds", 5, "--max-cpu", 2.1, "--json")
    answer = overflight(*words)
    assert answer.code == 0, answer.err
    best = json.loads(answer.out)["ranking"][0]
    assert best["report"]["cpu"]["process_cores"] <= 2.1
    assert [verdict["met"] for verdict in best["expectations"]] == [True]
    answer = overflight(*words, "--min-rate", "semantic_map=9.9")
    assert answer.code == 1
    assert not all(v["met"] for v in json.loads(answer.out)["ranking"][0]["expectations"])


def test_the_shipped_expectations_are_judged_without_running_anything(
    overflight: Callable[..., Any],
) -> None:
    expect = GRAPHS / "plan" / "expectations.yaml"
    words = ("plan", UAV, "--overlay", expect, "--seconds", 6, "--json")
    answer = overflight(*words)
    assert answer.code == 0, answer.err
    found = json.loads(answer.out)["ranking"][0]["expectations"]
    assert {verdict["key"] for verdict in found} == {
        "min_rate_hz",
        "max_age_ms",
        "max_gap_ms",
        "max_drop_percent",
        "max_cpu_cores",
    }
    answer = overflight(*words, "--costs", COSTS)  # the paper's fusion takes 100 ms and more
    assert answer.code == 1
    best = json.loads(answer.out)["ranking"][0]["report"]["outputs"]
    assert best["semantic_map/out"]["rate_hz"], "an output that says nothing is no way to meet more"


def test_a_person_gets_the_ranking_the_bottleneck_and_the_picture(
    overflight: Callable[..., Any], tmp_path: Path
) -> None:
    words = ("plan", UAV, "--costs", COSTS, "--seconds", 4, "--picture", "out/schedule.svg")
    answer = overflight(*words)
    assert answer.code == 0, answer.err
    said = " ".join(answer.out.split())
    assert "8 assignments of stages to devices, 4 virtual s each, 4 cores" in said
    assert "The bottleneck is device edgetpu busy" in said
    assert "--set stages." in said
    assert "segment_rgb infer" in (tmp_path / "out" / "schedule.svg").read_text()


def test_what_time_does_not_allow_is_skipped_and_said(overflight: Callable[..., Any]) -> None:
    answer = overflight("plan", UAV, "--costs", COSTS, "--seconds", 2, "--limit", 0)
    assert answer.code == 0, answer.err
    said = " ".join(answer.out.split())
    assert "1 of 8 assignments" in said
    assert "7 were skipped" in said


def test_ctrl_c_ends_the_search_with_what_is_there(
    overflight: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    import tools.planning.plan

    plans = iter([None, None])

    def interrupted(*words: Any, **settings: Any) -> Any:
        if next(plans, "over") == "over":
            raise KeyboardInterrupt
        return run_plan(*words, **settings)

    monkeypatch.setattr(tools.planning.plan, "run_plan", interrupted)
    answer = overflight("plan", UAV, "--costs", COSTS, "--seconds", 2, "--json")
    assert answer.code == 0, answer.err
    assert json.loads(answer.out)["skipped"] == 6


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--min-rate", "semantic_mop=9"], "did you mean 'semantic_map'?"),
        (["--min-rate", "semantic_map"], "write OUTPUT=HZ"),
        (["--costs", "none.yaml"], "none.yaml: cannot be read"),
    ],
)
def test_a_mistake_is_one_sentence(
    overflight: Callable[..., Any], words: list[str], sentence: str
) -> None:
    answer = overflight("plan", UAV, *words)
    assert answer.code == 2
    assert sentence in " ".join(answer.err.replace("│", " ").split())


def test_a_sensor_whose_rate_is_not_known_needs_an_entry_in_the_table(
    overflight: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "quiet.py").write_text(
        "from collections.abc import Iterator\n"
        "from pipeline.message import Message\n"
        "from pipeline.stage import Source\n"
        "from stages.types import Pose\n"
        "class Quiet(Source):\n"
        "    def messages(self) -> Iterator[Message[Pose]]:\n"
        "        return iter(())\n"
    )
    (tmp_path / "graph.yaml").write_text(
        "overflight: 1\ngraph: quiet\nstages:\n  poses: {use: quiet:Quiet}\n"
        "  sink: {use: stages.sinks.count:Count, inputs: {message: poses}}\n"
    )
    answer = overflight("plan", "graph.yaml")
    assert answer.code == 2
    assert "sources: {poses: {period_ms:" in answer.err
    (tmp_path / "costs.yaml").write_text("sources: {poses: {period_ms: 100}}")
    answer = overflight("plan", "graph.yaml", "--costs", "costs.yaml", "--seconds", 2)
    assert answer.code == 0, answer.err
    assert "1 assignment of stages" in " ".join(answer.out.split())
