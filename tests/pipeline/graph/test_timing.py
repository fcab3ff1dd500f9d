from __future__ import annotations

from pathlib import Path

import pytest
from graph_stages import Models

from pipeline.graph.graph import load_graph

SENSORS = """
  slow: {use: graph_stages:Camera, options: {rate_hz: 10}}
  fast: {use: graph_stages:Camera, options: {rate_hz: 30, jitter_ms: 2}}
  late: {use: graph_stages:Camera, options: {rate_hz: 20, delay_ms: 80}}
  lidar: {use: graph_stages:Lidar, options: {path: x}}
  poses: {use: graph_stages:Odometry}
"""


def warnings(tmp_path: Path, *lines: str) -> list[str]:
    """What is warned of, without place; sensors that nobody reads are not the subject here."""
    path = tmp_path / "graph.yaml"
    stages = "\n".join(f"  {line}" for line in lines)
    path.write_text(f"overflight: 1\ngraph: t\nstages:{SENSORS}{stages}\n")
    graph = load_graph(path, catalog=Models())
    return [
        f"{warning.path}: {warning.what}"
        for warning in graph.warnings
        if "nobody reads" not in warning.what
    ]


def pair(left: str, right: str) -> str:
    return f"pair: {{use: graph_stages:Pair, inputs: {{left: {left}, right: {right}}}}}"


def nearest(stage: str, tolerance_ms: float, more: str = "") -> str:
    return f"{{from: {stage}, sync: nearest, tolerance_ms: {tolerance_ms}{more}}}"


def test_a_tolerance_below_half_a_period_is_warned_of(tmp_path: Path) -> None:
    assert warnings(tmp_path, pair("fast", nearest("slow", 49))) == [
        "stages.pair.inputs.right.tolerance_ms: 49 ms cannot always be met: slow/out comes every "
        "100 ms, so the nearest may lie 50 ms away"
    ]
    assert warnings(tmp_path, pair("fast", nearest("slow", 50))) == []


def test_jitter_widens_the_tolerance_that_is_needed(tmp_path: Path) -> None:
    assert warnings(tmp_path, pair("slow", nearest("fast", 17))) == [
        "stages.pair.inputs.right.tolerance_ms: 17 ms cannot always be met: fast/out comes every "
        "33.33 ms with 2 ms of jitter, so the nearest may lie 18.67 ms away"
    ]
    assert warnings(tmp_path, pair("slow", nearest("fast", 18.7))) == []


def test_the_rate_of_a_source_reaches_stages_behind_it(tmp_path: Path) -> None:
    blur = "blur: {use: graph_stages:Blur, inputs: {image: slow}}"
    assert len(warnings(tmp_path, blur, pair("fast", nearest("blur", 20)))) == 1


@pytest.mark.parametrize(("rate_hz", "period"), [(10, "100 ms"), (11, "100 ms"), (29, "33.33 ms")])
def test_a_rate_limit_keeps_every_so_manieth_message(
    tmp_path: Path, rate_hz: float, period: str
) -> None:
    (warning,) = warnings(tmp_path, pair("slow", nearest("fast", 1, f", rate_hz: {rate_hz}")))
    assert f"comes every {period}" in warning


def test_streams_of_one_source_meet_exactly(tmp_path: Path) -> None:
    blur = "blur: {use: graph_stages:Blur, inputs: {image: slow}}"
    assert warnings(tmp_path, blur, pair("slow", nearest("blur", 1))) == []


def test_a_wait_that_is_over_before_the_input_arrives_is_warned_of(tmp_path: Path) -> None:
    assert warnings(tmp_path, pair("fast", nearest("late", 30, ", max_wait_ms: 79"))) == [
        "stages.pair.inputs.right.max_wait_ms: 79 ms is over before late/out usually arrives, "
        "80 ms after the trigger; sets will go without it"
    ]
    assert warnings(tmp_path, pair("fast", nearest("late", 30, ", max_wait_ms: 80"))) == []


def test_a_trigger_that_is_late_itself_leaves_more_time(tmp_path: Path) -> None:
    assert warnings(tmp_path, pair("late", nearest("fast", 30, ", max_wait_ms: 0"))) == []


def test_the_default_wait_of_exact_is_two_periods_of_the_trigger(tmp_path: Path) -> None:
    (warning,) = warnings(tmp_path, pair("fast", "{from: late, sync: exact}"))
    assert "66.67 ms is over before late/out usually arrives" in warning


def test_a_stage_that_waits_is_late_for_the_next_one(tmp_path: Path) -> None:
    blur = "blur: {use: graph_stages:Blur, inputs: {image: pair}}"
    second = pair("fast", nearest("blur", 50, ", max_wait_ms: 70")).replace("pair", "second")
    assert warnings(tmp_path, pair("slow", nearest("late", 25)), blur, second) == [
        "stages.second.inputs.right.max_wait_ms: 70 ms is over before blur/out usually arrives, "
        "80 ms after the trigger; sets will go without it"
    ]


def test_a_long_queue_says_how_old_it_makes_messages(tmp_path: Path) -> None:
    queue = "{{from: lidar, queue: {{policy: block, size: {}}}}}"
    save = "save: {{use: graph_stages:Save, inputs: {{thing: " + queue + "}}}}"
    assert warnings(tmp_path, save.format(20)) == [
        "stages.save.inputs.thing.queue: when full, its 20 messages add 1900 ms of age at 10 Hz; "
        "size 2 adds one period, 100 ms, and policy latest none"
    ]
    assert warnings(tmp_path, save.format(2)) == []


def test_what_is_not_known_is_not_warned_of(tmp_path: Path) -> None:
    poses = "{from: poses, sync: span, max_wait_ms: 0}"
    fuse = f"fuse: {{use: graph_stages:Fuse, inputs: {{scan: lidar, poses: {poses}}}}}"
    assert warnings(tmp_path, fuse) == []


def test_unread_outputs_lone_selects_and_unused_parameters_are_warned_of(tmp_path: Path) -> None:
    path = tmp_path / "graph.yaml"
    path.write_text(
        "overflight: 1\ngraph: t\nparameters: {voxel_m: 1}\nstages:\n"
        "  rgb: {use: graph_stages:Camera}\n"
        "  one: {use: graph_stages:Blur, inputs: {image: {from: rgb, select: rgb}}}\n"
        "  two: {use: graph_stages:Blur, inputs: {image: {from: rgb, select: rbg}}}\n"
        "  save: {use: graph_stages:Save, inputs: {thing: one}}\n"
    )
    graph = load_graph(path, catalog=Models())
    assert [str(warning).removeprefix(f"{path}:") for warning in graph.warnings] == [
        "3:23: parameters.voxel_m: nothing uses $voxel_m",
        "6:69: stages.one.inputs.image.select: no other input on rgb/out has the select 'rgb'; did "
        "you mean 'rbg'?",
        "7:3: stages.two: nobody reads its output two/out",
        "7:69: stages.two.inputs.image.select: no other input on rgb/out has the select 'rbg'; did "
        "you mean 'rgb'?",
    ]
