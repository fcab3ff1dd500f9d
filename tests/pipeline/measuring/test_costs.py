from __future__ import annotations

import math
from pathlib import Path

import pytest

from pipeline.errors import DataError
from pipeline.measuring.costs import Costs, Spread, StageCost, read_costs
from pipeline.scheduling.events import Step


def test_the_table_in_the_docstring_can_be_read(tmp_path: Path) -> None:
    import pipeline.measuring.costs as module

    assert module.__doc__ is not None
    lines = [line[4:] for line in module.__doc__.splitlines() if line.startswith("    ")]
    file = tmp_path / "costs.yaml"
    file.write_text("\n".join(lines))
    table = read_costs(file)
    detect = table.of("detect_rgb", "edgetpu")
    assert detect is not None
    assert detect.infer_ms == Spread(p50=17.5, p99=17.5)
    assert detect.cpu(Step.INFER) == 0.1
    assert table.sources["rgb"].period_ms == 33.3
    assert table.machine.event_us == 60


def test_the_shipped_costs_can_be_read(root: Path) -> None:
    table = read_costs(root / "graphs" / "plan" / "paper_costs.yaml")
    assert {"segment_rgb", "fuse_cloud"} <= {cost.stage for cost in table.costs}


def test_every_cost_of_the_paper_says_whether_it_was_measured_or_fitted(root: Path) -> None:
    text = (root / "graphs" / "plan" / "paper_costs.yaml").read_text()
    after = text[text.index("costs:\n") :]
    figures = [line for line in after.splitlines() if "_ms:" in line]
    assert figures
    assert all("Table 1" in line or "fitted" in line for line in figures)


def test_of_a_stage_without_a_model_any_entry_holds_and_the_last_counts() -> None:
    entries = ({"stage": "fuse", "process_ms": 1}, {"stage": "fuse", "process_ms": 2})
    table = Costs.model_validate({"costs": entries})
    found = table.of("fuse", None)
    assert found is not None
    assert found.process_ms == Spread(p50=2, p99=2)
    assert table.of("fuse", "gpu") is None


def test_a_step_on_the_cpu_computes_all_the_time_unless_the_table_knows_better() -> None:
    cost = StageCost.model_validate({"stage": "a", "prepare_ms": 4, "infer_ms": 9})
    assert cost.cpu(Step.PREPARE) == 4
    assert cost.cpu(Step.INFER) == 0
    assert cost.cpu(Step.FINISH) == 0


def test_the_mean_is_that_of_a_log_normal_distribution() -> None:
    time = Spread(p50=10, p99=20)
    assert time.p50 * math.exp(2.3263 * time.sigma) == pytest.approx(20)
    assert time.mean == pytest.approx(10 * math.exp((math.log(2) / 2.3263) ** 2 / 2))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("costs: [{stage: a, process_ms: -1}]", "costs.0.process_ms"),
        ("costs: [{stage: a, process_ms: {p50: 2, p99: 1}}]", "p99 (1) is below p50 (2)"),
        ("costs: [{process_ms: 1}]", "costs.0: misses 'stage'"),
        ("costs: [{stage: a, cpu_ms: {proces: 1}}]", "process"),
        ("sources: {a: {period_ms: 0}}", "sources.a.period_ms: must be above 0, not 0"),
        ("sources: {a: {period_ms: 10, jitter_ms: 6}}", "stamps run backward"),
        ("costs: [", "is not YAML"),
        ("12", "the file: expected a mapping, got 12"),
    ],
)
def test_a_wrong_table_names_its_place(tmp_path: Path, text: str, sentence: str) -> None:
    file = tmp_path / "costs.yaml"
    file.write_text(text)
    with pytest.raises(DataError) as caught:
        read_costs(file)
    assert str(file) in str(caught.value)
    assert sentence in str(caught.value)


def test_a_missing_table_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot be read"):
        read_costs(tmp_path / "none.yaml")
