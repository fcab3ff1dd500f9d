"""The command, over two networks on an emulated device."""

from __future__ import annotations

import json
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from pipeline.measuring.costs import read_costs
from pipeline.scheduling.events import Step

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

GRAPH = """\
overflight: 1
graph: two
devices:
  tpu: {use: accelerators.emulated:Emulated, latency_ms: {detect-rgb: 10, detect-thermal: 5}}
  gpu: {use: accelerators.emulated:Emulated, latency_ms: {detect-rgb: 20}}
stages:
  rgb:
    use: stages.sources.emulated:EmulatedCamera
    options: {rate_hz: 30, jitter_ms: 1, width: 160, height: 96}
  thermal:
    use: stages.sources.emulated:EmulatedThermal
    options: {rate_hz: 20, width: 160, height: 128}
  detect_rgb:
    use: stages.detect:DetectObjects
    executor: tpu
    model: detect-rgb
    inputs: {image: rgb}
  detect_thermal:
    use: stages.detect:DetectObjects
    executor: tpu
    model: detect-thermal
    inputs: {image: thermal}
  seen: {use: stages.sinks.count:Count, inputs: {message: detect_rgb}}
  seen_warm: {use: stages.sinks.count:Count, inputs: {message: detect_thermal}}
"""


class Tags(HTMLParser):
    """Every opened tag is closed, and nothing is fetched."""

    VOID = ("meta",)

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []
        self.fetched: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append(tag)
        self.fetched += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def checked(path: Path) -> Tags:
    tags = Tags()
    tags.feed(path.read_text())
    assert tags.open == []
    assert tags.fetched == []
    assert "script" not in tags.seen
    return tags


@pytest.fixture
def graph(tmp_path: Path) -> Path:
    path = tmp_path / "two.yaml"
    path.write_text(GRAPH)
    return path


def test_one_run_says_what_each_stage_costs(overflight: Callable[..., Any], graph: Path) -> None:
    answer = overflight(
        *("profile", graph, "--duration", 3, "--json"),
        *("--html", "page.html", "--save-costs", "costs.yaml"),
    )
    assert answer.code == 0, answer.err
    page = json.loads(answer.out)["profile"]
    rows = {row["stage"]: row for row in page["stages"]}
    assert set(rows["detect_rgb"]["cpu_ms"]) == {"prepare", "infer", "finish"}
    assert rows["detect_rgb"]["emulated"]
    assert not rows["seen"]["emulated"]
    assert rows["detect_rgb"]["devices"] == ["tpu"]
    wall = rows["detect_rgb"]["steps"]["tpu"]["infer"]["wall_ms"]
    assert wall["p50"] > 9
    lines = [row["cpu_percent"] for row in page["stages"]] + list(page["rest_percent"].values())
    assert sum(lines) == pytest.approx(page["process_percent"], abs=0.1)
    assert {"scheduler", "drivers", "garbage collector", "unattributed"} <= set(
        page["rest_percent"]
    )
    assert checked(Path("page.html")).seen.count("svg") == 3

    costs = read_costs(Path("costs.yaml"))
    assert costs.sources["rgb"].period_ms == pytest.approx(1e3 / 30, rel=1e-4)
    assert costs.sources["rgb"].jitter_ms == 1
    detect = costs.of("detect_rgb", "tpu")
    assert detect is not None
    infer = detect.time(Step.INFER)
    assert infer is not None
    assert (infer.p50, infer.p99) == (wall["p50"], wall["p99"])
    assert detect.cpu(Step.PREPARE) > 0
    assert costs.of("seen", None) is not None


def test_a_sweep_measures_each_model_on_each_device_that_takes_it(
    overflight: Callable[..., Any], graph: Path
) -> None:
    answer = overflight(
        *("profile", graph, "--duration", 1, "--sweep", "executor", "--sweep", "rate_hz=5"),
        *("--plot", "load.svg", "--html", "page.html"),
    )
    assert answer.code == 0, answer.err
    assert "[1/4] detect_rgb on tpu at 5 Hz: " in answer.err
    assert "not run: detect_thermal on gpu" in " ".join(answer.out.split())
    assert "~detect_rgb" in answer.out
    names = [text.text for text in ElementTree.parse("load.svg").iter() if text.text]
    assert {"~detect_rgb, tpu", "~detect_rgb, gpu", "~detect_thermal, tpu"} <= set(names)
    checked(Path("page.html"))


def test_a_table_without_html_reads_in_eighty_columns(
    overflight: Callable[..., Any], graph: Path
) -> None:
    answer = overflight("profile", graph, "--duration", 1)
    assert answer.code == 0, answer.err
    assert "…" not in answer.out
    assert max(map(len, answer.out.splitlines())) <= 80
    assert "everything together" in answer.out


def test_a_plot_without_a_sweep_is_a_mistake(overflight: Callable[..., Any], graph: Path) -> None:
    answer = overflight("profile", graph, "--plot", "load.svg")
    assert answer.code == 2
    assert "add one, e.g. --sweep executor" in " ".join(answer.err.replace("│", " ").split())
