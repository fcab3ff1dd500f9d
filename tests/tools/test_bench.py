"""The benchmarks run and print their rows; what they measure is BENCHMARK.md's, not a test's."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer import Typer
from typer.testing import CliRunner

from pipeline.drivers.run import RunResult
from pipeline.scheduling.sync import Synchronizer
from tools.bench import emulated
from tools.bench.__main__ import NAMES, bench
from tools.bench.approximate_time import ApproximateTime
from tools.bench.harness import (
    Effort,
    Latency,
    Ratio,
    Row,
    interleave,
    latency_row,
    quantile,
    ratio,
)
from tools.bench.sync import CAMERA, LIDAR, NEAREST, TRIGGER, by_arrival, gap_row, play

#: Those that run on the real clock: what computes beside them would make them lose messages.
LIVE = (
    *("hop", "chain", "emulated", "fanout", "wanted", "plan", "trace", "recording", "transport"),
)

app = Typer()
app.command()(bench)


def table(text: str) -> list[list[str]]:
    """The cells of a Markdown table's lines."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.realtime] if name in LIVE else []) for name in NAMES],
)
def test_each_benchmark_prints_rows_under_the_head(name: str, tmp_path: Path) -> None:
    words = [name, "--quick", "--seconds", "2", "--json", str(tmp_path / "figures.json")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    head, rule, *rows = table(result.output)
    assert rows
    assert {len(cells) for cells in (head, rule, *rows)} == {len(head)}
    assert {cells[0] for cells in rows} == {name}
    assert all(re.search(r"\d", cells[head.index("measured")]) for cells in rows)
    document = json.loads((tmp_path / "figures.json").read_text())
    assert document["quick"]
    assert {"cpu", "cores", "kernel", "commit", "versions"} <= document["machine"].keys()
    assert [row["figure"] for row in document["benchmarks"][name]] == [r[1] for r in rows]


def test_an_unknown_benchmark_is_named_with_those_there_are() -> None:
    result = CliRunner().invoke(app, ["hopp", "--quick"])
    assert result.exit_code == 2
    assert "hopp" in result.output
    assert "hop," in result.output


def test_benchmark_md_names_every_benchmark(root: Path) -> None:
    page = (root / "BENCHMARK.md").read_text()
    assert [name for name in NAMES if f"python -m tools.bench {name}" not in page] == []


def test_every_side_is_measured_once_a_round_and_not_always_in_the_same_order() -> None:
    order: list[str] = []

    def side(name: str) -> int:
        order.append(name)
        return len(order)

    measured = interleave({name: lambda name=name: side(name) for name in "ab"}, 10)
    rounds = [order[i : i + 2] for i in range(0, 20, 2)]
    assert all(sorted(names) == ["a", "b"] for names in rounds)
    assert len({tuple(names) for names in rounds}) == 2
    assert [len(each) for each in measured.values()] == [10, 10]


def test_a_ratio_is_taken_round_by_round() -> None:
    # The second round ran on a machine ten times slower: no round says anything but 2 or 3.
    assert ratio([2.0, 20.0, 3.0], [1.0, 10.0, 1.0]) == Ratio(2.0, 2.0, 3.0)


def test_a_row_meets_its_goal_only_where_both_ratios_do() -> None:
    floor = Latency([[1.0] * 99 + [2.0]])
    fast, late = Latency([[1.4] * 100]), Latency([[1.4] * 98 + [9.0] * 2])
    assert latency_row("x", fast, floor, "floor", p50=1.5, p99=3).met
    assert not latency_row("x", late, floor, "floor", p50=1.5, p99=3).met
    assert not latency_row("x", Latency([[1.6] * 100]), floor, "floor", p50=1.5, p99=3).met
    assert latency_row("x", fast, floor, "floor", p50=1.5, hold=False).met is None


@given(st.lists(st.floats(0, 1e6), min_size=1))
def test_the_median_and_p99_are_values_that_were_measured(values: list[float]) -> None:
    assert min(values) <= quantile(values, 0.5) <= quantile(values, 0.99) <= max(values)
    assert {quantile(values, 0.5), quantile(values, 0.99)} <= set(values)


def test_the_baseline_takes_the_first_set_within_the_slop_and_not_the_nearest() -> None:
    baseline = ApproximateTime(2, slop=50)
    assert baseline.add(1, 60) is None
    assert baseline.add(0, 100) == (100, 60)
    assert baseline.add(1, 99) is None, "the trigger at 100 is used up"


def test_the_baseline_forms_no_set_wider_than_the_slop() -> None:
    baseline = ApproximateTime(3, slop=50)
    assert baseline.add(0, 0) is None
    assert baseline.add(1, 90) is None
    assert baseline.add(2, 45) is None, "0 and 90 are both near 45, but 90 apart"
    assert baseline.add(0, 60) == (60, 90, 45)


def test_the_gap_row_finds_the_synchronizer_at_the_optimum() -> None:
    row = gap_row("frames", by_arrival([LIDAR, CAMERA], 5))
    assert isinstance(row, Row)
    assert row.met
    assert row.values["baseline_ms"] >= row.values["optimum_ms"]


def test_every_trigger_that_is_followed_by_frames_gets_its_set() -> None:
    events = by_arrival([LIDAR, CAMERA], 5)
    sets = list(play(Synchronizer([TRIGGER, NEAREST], offline=True), events))
    stamps = [message.stamp for stream, message in events if not stream]
    assert [scan.stamp for scan, _ in sets] == stamps[: len(sets)]
    assert len(sets) >= len(stamps) - 1


def test_a_run_that_ended_early_is_no_measurement(monkeypatch: pytest.MonkeyPatch) -> None:
    # A signal ends a run without a failure, and its rates look right.
    short = RunResult({"wall_s": 31.0}, failures=())
    monkeypatch.setattr(emulated, "run_graph", lambda *_, **__: short)
    with pytest.raises(RuntimeError, match=r"ended after 31\.0 of 60 s"):
        emulated.measure(Effort(seconds=60))
