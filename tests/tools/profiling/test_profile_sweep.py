from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
import typer

from accelerators.registry import Registry
from pipeline.graph.graph import Graph, load_graph
from tools.profiling.profile_sweep import Sweep, points


@pytest.fixture(scope="module")
def catalog() -> Registry:
    return Registry.open()


@pytest.fixture(scope="module")
def uav(root: Path, catalog: Registry) -> Graph:
    overlay = root / "graphs/profile/table1.yaml"
    return load_graph(root / "graphs/emulated_uav.yaml", catalog=catalog, overlays=[overlay])


def no_overlay(path: Path) -> Graph:
    raise AssertionError(path)


def test_a_sweep_is_read_from_its_words() -> None:
    assert Sweep.parse(["executor", "rate_hz=1,2.5"]) == Sweep(True, (1.0, 2.5))
    assert Sweep.parse(["overlay=a.yaml, b.yaml"]).overlays == (Path("a.yaml"), Path("b.yaml"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["rates=1"], "'rates=1' is no sweep; write executor"),
        (["rate_hz="], "'rate_hz=' is no sweep"),
        (["executor=cpu"], "'executor=cpu' is no sweep"),
        (["rate_hz=fast"], "rate_hz=fast: a rate is a number above 0"),
        (["rate_hz=1,-2"], "rate_hz=-2"),
        (["overlay=a.yaml", "executor"], "a command of its own"),
    ],
)
def test_a_word_that_is_no_sweep_is_told_the_way_out(words: list[str], said: str) -> None:
    with pytest.raises(typer.BadParameter, match=said):
        Sweep.parse(words)


def test_executor_and_rates_multiply_over_every_model(uav: Graph, catalog: Registry) -> None:
    every = points(uav, catalog, Sweep.parse(["executor", "rate_hz=1,5"]), no_overlay)
    models = [stage.name for stage in uav.stages if stage.model]
    assert len(models) == 5
    assert len(every) == len(models) * 2 * 2
    assert str(every[1]) == "segment_rgb on edgetpu at 5 Hz"
    assert str(every[2]) == "segment_rgb on igpu at 1 Hz"
    assert {stage.name for stage in every[0].graph.stages} == {"rgb", "segment_rgb"}


def test_without_executor_each_model_stays_where_it_is(uav: Graph, catalog: Registry) -> None:
    every = points(uav, catalog, Sweep.parse(["rate_hz=1"]), no_overlay)
    assert {(p.variant, p.device) for p in every} == {
        *(("segment_rgb", "edgetpu"), ("detect_rgb", "edgetpu"), ("detect_thermal", "edgetpu")),
        *(("segment_scan", "igpu"), ("segment_scan_1024x128", "igpu")),
    }


def test_the_shipped_rows_of_table_2_grow_from_one_network_to_the_map(
    root: Path, catalog: Registry
) -> None:
    def overlay(path: Path) -> Graph:
        file = root / "graphs/emulated_uav.yaml"
        return load_graph(file, catalog=catalog, overlays=[path])

    rows = ("segmentation", "segmentation_detection", "image_networks", "image_fusion")
    files = [root / f"graphs/profile/{row}.yaml" for row in (*rows, "everything")]
    every = points(overlay(files[0]), catalog, Sweep(overlays=tuple(files)), overlay)
    stages = [{stage.name for stage in point.graph.stages} for point in every]
    assert all(fewer < more for fewer, more in pairwise(stages))
    assert stages[0] == {"rgb", "segment_rgb"}
    assert [sum(1 for s in point.graph.stages if s.model) for point in every] == [1, 2, 3, 3, 4]
    assert "semantic_map" in stages[-1]
