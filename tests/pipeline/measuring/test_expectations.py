from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.graph.spec import ExpectSpec
from pipeline.measuring.expectations import failed, lost_percent, verdicts


def report(**output: Any) -> dict[str, Any]:
    """10 s of an output at 10 Hz, 120 ms old, from an edge that loses one in ten."""
    of = {"count": 100, "rate_hz": 10.0, "longest_gap_ms": 130.0}
    of["age_from_stamp_ms"] = {"p50": 100.0, "p99": 120.0}
    book = {"produced": 100, "dropped": {"replaced": 10, "passed_over": 50, "end": 3}}
    return {
        "offline": False,
        "wall_s": 10.0,
        "outputs": {"a/out": {**of, **output}},
        "edges": {"camera/out->a/x": book, "camera/out->b/x": {"produced": 0, "dropped": {}}},
        "cpu": {"process_cores": 1.25},
    }


def judged(page: dict[str, Any], **rules: Any) -> tuple[str, ...]:
    return failed(verdicts(ExpectSpec.model_validate(rules), page))


@pytest.mark.parametrize(
    ("rules", "sentences"),
    [
        ({}, ()),
        ({"outputs": {"a/out": {"min_rate_hz": 9.9}}}, ()),
        (
            {"outputs": {"a/out": {"min_rate_hz": 11}}},
            ("a/out: rate 10 Hz, expected at least 11 Hz",),
        ),
        ({"outputs": {"a/out": {"max_age_ms": 120}}}, ()),
        (
            {"outputs": {"a/out": {"max_age_ms": 119}}},
            ("a/out: age at p99 120 ms, expected at most 119 ms",),
        ),
        (
            {"outputs": {"a/out": {"max_gap_ms": 110}}},
            ("a/out: longest gap 130 ms, expected at most 110 ms",),
        ),
        ({"inputs": {"a/x": {"max_drop_percent": 10}}}, ()),
        (
            {"inputs": {"b/x": {"max_drop_percent": 50}}},
            ("camera/out->b/x: lost not known, nothing came, expected at most 50 %",),
        ),
        (
            {"inputs": {"a/x": {"max_drop_percent": 9}}},
            ("camera/out->a/x: lost 10 %, expected at most 9 %",),
        ),
        ({"max_cpu_cores": 1.25}, ()),
        ({"max_cpu_cores": 1}, ("the process: CPU 1.25 cores, expected at most 1 cores",)),
    ],
)
def test_a_report_is_held_against_each_rule(
    rules: dict[str, Any], sentences: tuple[str, ...]
) -> None:
    assert judged(report(), **rules) == sentences


def test_an_output_that_never_spoke_fails_all_its_rules() -> None:
    silent = report(count=0, rate_hz=None, longest_gap_ms=0.0, age_from_stamp_ms={"p99": None})
    rules = {"a/out": {"min_rate_hz": 1, "max_age_ms": 100, "max_gap_ms": 5000}}
    assert judged(silent, outputs=rules) == (
        "a/out: rate 0 Hz, expected at least 1 Hz",
        "a/out: age at p99 not known, nothing came, expected at most 100 ms",
        "a/out: longest gap 1e+04 ms, expected at most 5000 ms",
    )


def test_an_output_that_died_half_way_does_not_pass_by_its_rate_before() -> None:
    died = report(count=51, rate_hz=10.0)
    rules = {"a/out": {"min_rate_hz": 9, "max_gap_ms": 1000}}
    assert judged(died, outputs=rules) == (
        "a/out: rate 5.556 Hz, expected at least 9 Hz",
        "a/out: longest gap 4000 ms, expected at most 1000 ms",
    )


def test_a_second_of_silence_at_start_and_end_together_is_no_fault() -> None:
    late = report(count=91, rate_hz=10.0)
    assert not judged(late, outputs={"a/out": {"min_rate_hz": 10, "max_gap_ms": 130}})


def test_offline_judges_losses_alone() -> None:
    offline = {**report(rate_hz=None, longest_gap_ms=None, age_from_stamp_ms=None), "offline": True}
    rules = ExpectSpec.model_validate(
        {
            "outputs": {"a/out": {"min_rate_hz": 99, "max_age_ms": 1, "max_gap_ms": 1}},
            "inputs": {"a/x": {"max_drop_percent": 1}},
            "max_cpu_cores": 0.1,
        }
    )
    found = verdicts(rules, offline)
    assert [verdict.met for verdict in found] == [None, None, None, None, False]
    assert len(failed(found)) == 1


@given(st.dictionaries(st.sampled_from(["replaced", "queue_full", "too_old"]), st.integers(0, 50)))
def test_what_is_lost_is_a_share_of_what_came(dropped: dict[str, int]) -> None:
    produced = sum(dropped.values()) + 10
    percent = lost_percent({"produced": produced, "dropped": dropped})
    assert percent == pytest.approx(100 * sum(dropped.values()) / produced)
