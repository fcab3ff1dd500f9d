from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from pipeline.drivers.plan import Plan
from pipeline.measuring.expectations import Verdict
from tools.planning.plan_ranking import Option, Ranking, assignment, bottleneck, ranked


def option(
    name: str,
    rate: float | None = 10.0,
    age: float | None = 100.0,
    cores: float = 1.0,
    met: bool = True,
    busy: float = 0.5,
) -> Option:
    report = {
        "outputs": {"map/out": {"rate_hz": rate, "age_from_stamp_ms": {"p99": age}}},
        "cpu": {"process_cores": cores},
        "devices": {"tpu": {"busy_fraction": busy, "stages": {"net": {"busy_fraction": busy}}}},
    }
    verdict = Verdict("map/out", "min_rate_hz", 1.0, rate, met)
    return Option({"net": name}, False, Plan(report, {"net": 0.2}, (), 0), (verdict,))


def order(*options: Option) -> list[str]:
    return [each.devices["net"] for each in ranked(options, ("map/out",))]


def test_demands_go_before_age_and_age_before_rate_and_rate_before_cpu() -> None:
    assert order(option("young", age=50, met=False), option("meets")) == ["meets", "young"]
    assert order(option("fast", rate=20), option("young", age=50)) == ["young", "fast"]
    assert order(option("cheap", cores=0.5), option("fast", rate=20)) == ["fast", "cheap"]
    assert order(option("dear"), option("cheap", cores=0.5)) == ["cheap", "dear"]


def test_what_differs_by_less_than_a_twentieth_counts_as_equal() -> None:
    assert order(option("young", age=99.0), option("fast", rate=20)) == ["fast", "young"]


def test_an_output_that_says_nothing_comes_last_whatever_it_meets() -> None:
    assert order(option("silent", rate=None, age=None), option("late", met=False)) == [
        "late",
        "silent",
    ]


def test_an_assignment_is_told_by_device() -> None:
    devices = {"a": "tpu", "b": "gpu", "c": "tpu"}
    assert assignment(devices) == "gpu: b; tpu: a, c"


def test_the_bottleneck_is_everything_that_is_nearly_always_busy() -> None:
    stages = (SimpleNamespace(name="net", stateless=False),)
    graph = SimpleNamespace(topology=SimpleNamespace(stages=stages))
    ranking = cast(Ranking, cast(Any, SimpleNamespace(graph=graph, cores=2)))
    full = bottleneck(ranking, option("x", busy=0.99, cores=1.9))
    assert full.startswith("The bottleneck is device tpu busy 99 % of the time (net 99 %); then ")
    assert "the 2 cores busy 95 %" in full
    assert "sensors set the pace" in bottleneck(ranking, option("x", busy=0.6))
