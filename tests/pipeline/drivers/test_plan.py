from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from planning import costs, graph, source, stage

from pipeline.drivers.plan import Plan, run_plan
from pipeline.graph.graph import Graph
from pipeline.measuring.costs import Costs, Machine
from pipeline.scheduling.events import Step
from pipeline.scheduling.topology import Policy

CAMERA = source("camera")


def planned(of: Graph, table: Costs, seconds: float = 10.0, **settings: Any) -> Plan:
    plan = run_plan(of, table, seconds=seconds, record_s=(0.0, seconds), **settings)
    assert plan.report["ledger_balanced"]
    return plan


def rate(plan: Plan, output: str) -> float:
    found: float = plan.report["outputs"][output]["rate_hz"]
    return found


def p50(plan: Plan, output: str) -> float:
    age: float = plan.report["outputs"][output]["age_from_stamp_ms"]["p50"]
    return age


def test_a_device_that_is_faster_than_the_sensor_follows_it_with_the_time_of_its_steps() -> None:
    net = stage("net", "camera", devices=("tpu",), max_in_flight=2)
    entry = {"stage": "net", "device": "tpu", "prepare_ms": 2, "infer_ms": 20, "finish_ms": 3}
    plan = planned(graph(CAMERA, net), costs(50, entry))
    assert rate(plan, "net/out") == pytest.approx(20, rel=0.01)
    assert p50(plan, "net/out") == pytest.approx(25)
    assert plan.report["devices"]["tpu"]["busy_fraction"] == pytest.approx(0.4, rel=0.01)
    assert plan.report["cpu"]["process_cores"] == pytest.approx(0.1, rel=0.01)


def test_a_device_that_is_slower_than_the_sensor_is_never_idle() -> None:
    net = stage("net", "camera", devices=("tpu",), max_in_flight=2)
    entry = {"stage": "net", "device": "tpu", "prepare_ms": 2, "infer_ms": 40, "finish_ms": 3}
    plan = planned(graph(CAMERA, net), costs(10, entry))
    assert rate(plan, "net/out") == pytest.approx(25, rel=0.01)
    assert plan.report["devices"]["tpu"]["busy_fraction"] > 0.99


def test_steps_beyond_the_cores_slow_each_other_down() -> None:
    # Two stages on one core, started together, 10 ms of computing each: both end after 20 ms.
    stages = (stage("a", "camera"), stage("b", "camera"))
    entries = ({"stage": "a", "process_ms": 10}, {"stage": "b", "process_ms": 10})
    plan = planned(graph(CAMERA, *stages), costs(50, *entries), cores=1)
    assert p50(plan, "a/out") == pytest.approx(20)
    assert p50(plan, "b/out") == pytest.approx(20)
    assert plan.report["cpu"]["process_cores"] == pytest.approx(0.4, rel=0.01)
    alone = planned(graph(CAMERA, *stages), costs(50, *entries), cores=2)
    assert p50(alone, "a/out") == pytest.approx(10)


def test_a_step_that_ends_earlier_gives_its_core_back() -> None:
    # One core: 4 ms and 10 ms together. Until 8 ms they share, then the longer one has 6 ms left.
    stages = (stage("a", "camera"), stage("b", "camera"))
    entries = ({"stage": "a", "process_ms": 4}, {"stage": "b", "process_ms": 10})
    plan = planned(graph(CAMERA, *stages), costs(50, *entries), cores=1)
    assert p50(plan, "a/out") == pytest.approx(8)
    assert p50(plan, "b/out") == pytest.approx(14)


def test_what_a_step_waits_for_is_not_slowed_down_by_others() -> None:
    # One core, asked for 0.5 + 1: the first computes half of its 10 ms, which takes 1.5 times as
    # long, 12.5 ms; meanwhile 12.5 / 1.5 ms of the second are done, and the rest goes alone.
    stages = (stage("a", "camera"), stage("b", "camera"))
    entries = (
        {"stage": "a", "process_ms": 10, "cpu_ms": {"process": 5}},
        {"stage": "b", "process_ms": 10},
    )
    plan = planned(graph(CAMERA, *stages), costs(50, *entries), cores=1)
    assert p50(plan, "a/out") == pytest.approx(12.5)
    assert p50(plan, "b/out") == pytest.approx(12.5 + 10 - 12.5 / 1.5, abs=0.001)


def test_the_hosts_part_of_an_infer_takes_a_core_from_the_stages() -> None:
    net = stage("net", "camera", devices=("cpu",), max_in_flight=2)
    heavy = {"stage": "net", "device": "cpu", "infer_ms": 10, "cpu_ms": {"infer": 10}}
    light = {"stage": "net", "device": "cpu", "infer_ms": 10, "cpu_ms": {"infer": 0}}
    other = {"stage": "other", "process_ms": 10}
    stages = graph(CAMERA, net, stage("other", "camera"))
    assert p50(planned(stages, costs(50, heavy, other), cores=1), "other/out") == pytest.approx(20)
    assert p50(planned(stages, costs(50, light, other), cores=1), "other/out") == pytest.approx(10)


def test_reading_the_sensors_is_a_steady_load() -> None:
    reading = {"stage": "camera", "process_ms": 25}
    plan = planned(
        graph(CAMERA, stage("a", "camera")),
        costs(50, reading, {"stage": "a", "process_ms": 10}),
        cores=1,
    )
    assert p50(plan, "a/out") == pytest.approx(15)
    assert plan.report["cpu"]["process_cores"] == pytest.approx(0.7, rel=0.02)


def test_drawn_times_have_the_median_and_the_99th_percentile_of_the_table() -> None:
    table = costs(50, {"stage": "a", "process_ms": {"p50": 10, "p99": 25}})
    bars = planned(graph(CAMERA, stage("a", "camera")), table, seconds=400).bars
    took = [(bar.end - bar.begin) / 1e6 for bar in bars if bar.stage == "a"]
    assert np.median(took) == pytest.approx(10, rel=0.05)
    assert np.quantile(took, 0.99) == pytest.approx(25, rel=0.1)
    assert max(took) <= 10 * math.exp(3 * math.log(2.5) / 2.3263) + 1e-6


def test_the_same_seed_gives_the_same_plan_and_another_one_another() -> None:
    table = costs(50, {"stage": "a", "process_ms": {"p50": 10, "p99": 25}})
    several = [planned(graph(CAMERA, stage("a", "camera")), table, seed=seed) for seed in (1, 1, 2)]
    assert several[0] == several[1]
    assert several[0].report != several[2].report


def test_a_full_queue_that_blocks_holds_the_sensor_back_and_loses_nothing() -> None:
    slow = stage("slow", "camera", policy=Policy.BLOCK, size=2)
    plan = planned(graph(CAMERA, slow), costs(10, {"stage": "slow", "process_ms": 40}))
    assert rate(plan, "slow/out") == pytest.approx(25, rel=0.01)
    assert rate(plan, "camera/out") == pytest.approx(25, rel=0.02)
    assert not any(plan.report["edges"]["camera/out->slow/x"]["dropped"].values())


def test_what_a_slow_stage_does_not_take_is_in_the_ledger() -> None:
    plan = planned(
        graph(CAMERA, stage("slow", "camera")), costs(10, {"stage": "slow", "process_ms": 40})
    )
    assert plan.report["edges"]["camera/out->slow/x"]["dropped"]["replaced"] == pytest.approx(
        750, abs=5
    )
    assert plan.busy["slow"] > 0.98


def test_the_framework_costs_what_the_table_says_of_a_step_and_a_message() -> None:
    table = costs(50).model_copy(update={"machine": Machine(cores=2, event_us=500)})
    plan = planned(graph(CAMERA, stage("a", "camera")), table)
    assert plan.report["cpu"]["process_cores"] == pytest.approx(2 * 20 * 500e-6, rel=0.01)


def test_no_two_infers_of_a_device_and_no_two_steps_of_a_stage_overlap() -> None:
    nets = [stage(name, "camera", devices=("tpu",), max_in_flight=2) for name in ("a", "b")]
    entries = [
        {
            "stage": name,
            "device": "tpu",
            "prepare_ms": {"p50": 3, "p99": 9},
            "infer_ms": {"p50": 20, "p99": 30},
            "finish_ms": 2,
        }
        for name in ("a", "b")
    ]
    plan = planned(graph(CAMERA, *nets), costs(10, *entries), cores=1)
    lanes: dict[Any, list[tuple[int, int]]] = {}
    for bar in plan.bars:
        lanes.setdefault(bar.device or bar.stage, []).append((bar.begin, bar.end))
    assert set(lanes) == {"tpu", "a", "b"}
    for spans in lanes.values():
        spans.sort()
        assert all(one[1] <= other[0] for one, other in pairwise(spans))


def test_only_the_recorded_part_of_the_schedule_is_kept() -> None:
    table = costs(50, {"stage": "a", "process_ms": 10})
    plan = run_plan(graph(CAMERA, stage("a", "camera")), table, seconds=5, record_s=(1.0, 1.2))
    assert [bar.begin // 1_000_000 for bar in plan.bars] == [1000, 1050, 1100, 1150]
    assert {bar.step for bar in plan.bars} == {Step.PROCESS}
