from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from graph_stages import Camera, Chip, Lidar, Models, Rig

from pipeline.errors import GraphError
from pipeline.graph.graph import Graph, load_graph
from pipeline.scheduling.topology import Input, Missing, Policy, Port, StageNode, Sync

HERE = Path(__file__).parent
GOOD = HERE / "good_graph.yaml"


def load(path: Path = GOOD, *settings: str, **more: Any) -> Graph:
    return load_graph(path, catalog=Models(), settings=settings, **more)


def written(folder: Path, text: str, name: str = "graph.yaml") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def graph() -> Graph:
    return load()


def options(graph: Graph, stage: str) -> dict[str, Any]:
    return dict(graph.stage(stage).options)


def test_the_topology_has_every_rule_of_the_file_in_ns(graph: Graph) -> None:
    assert graph.topology.stage("fuse") == StageNode(
        name="fuse",
        inputs=(
            Input("scan", (Port("mount"),)),
            Input("poses", (Port("odometry"),), Sync.SPAN, max_wait=80_000_000),
            Input(
                "boxes",
                (Port("detect"),),
                Sync.NEAREST,
                many=True,
                tolerance=50_000_000,
                offset=-2_500_000,
                max_wait=200_000_000,
                missing=Missing.PROCEED,
            ),
        ),
    )
    detect = graph.topology.stage("detect")
    assert detect.devices == ("chip",)
    assert detect.max_in_flight == 2
    assert detect.trigger.max_age == 250_000_000
    save = graph.topology.stage("save")
    assert save.outputs == ()
    assert (save.trigger.policy, save.trigger.size) == (Policy.BLOCK, 2)
    assert graph.topology.stage("blur").inline
    assert graph.topology.workers == len(os.sched_getaffinity(0)) + 1


def test_stages_keep_the_order_of_the_file(graph: Graph) -> None:
    order = ["camera", "lidar", "mount", "odometry", "blur", "detect", "fuse", "save"]
    assert [stage.name for stage in graph.stages] == order
    assert [node.name for node in graph.topology.stages] == order


def test_a_stage_is_made_anew_each_time_with_its_options(graph: Graph) -> None:
    stage = graph.stage("camera")
    first, second = stage.make(), stage.make()
    assert isinstance(first, Camera)
    assert first is not second
    assert first.rate_hz == 15.0
    assert stage.model is None
    assert graph.stage("detect").model == "detect-rgb"
    assert str(stage.position).endswith("good_graph.yaml:9:3")


def test_a_device_is_made_with_its_options(graph: Graph) -> None:
    device = graph.devices["chip"].make()
    assert isinstance(device, Chip)
    assert device.threads == 2
    assert device.cache == HERE / "models"


def test_an_input_with_a_default_may_go_without_an_edge() -> None:
    fed = [entry.name for entry in load().topology.stage("fuse").inputs]
    assert fed == ["scan", "poses", "boxes"]
    graph = load(GOOD, "stages.fuse.inputs.boxes=")
    assert [entry.name for entry in graph.topology.stage("fuse").inputs] == ["scan", "poses"]


def test_the_models_that_stages_use_are_at_hand(graph: Graph) -> None:
    assert {name: spec.name for name, spec in graph.models.items()} == {"detect-rgb": "detect-rgb"}


def test_paths_begin_where_the_text_that_holds_them_lies(tmp_path: Path) -> None:
    written(tmp_path / "shared", "parameters: {scans: lidar}\n", "set.yaml")
    path = written(
        tmp_path,
        """
        overflight: 1
        graph: paths
        include: [shared/set.yaml]
        stages:
          a: {use: graph_stages:Lidar, options: {path: here}}
          b: {use: graph_stages:Lidar, options: {path: $scans}}
          c: {use: graph_stages:Lidar, options: {path: $scans/today}}
          d: {use: graph_stages:Lidar, options: {path: /abs}}
          s:
            use: graph_stages:Save
            options: {paths: [x, $out, $out/y, z$scans]}
            inputs: {thing: a}
        """,
    )
    graph = load(path, out=Path("results"))
    assert options(graph, "a")["path"] == tmp_path / "here"
    assert options(graph, "b")["path"] == tmp_path / "shared" / "lidar"
    assert options(graph, "c")["path"] == tmp_path / "shared" / "lidar" / "today"
    assert options(graph, "d")["path"] == Path("/abs")
    assert options(graph, "s")["paths"] == (
        tmp_path / "x",
        Path("results"),
        Path("results/y"),
        tmp_path / "zlidar",
    )
    moved = load(path, "parameters.scans=home", "stages.a.options.path=there")
    assert options(moved, "a")["path"] == Path("there")
    assert options(moved, "b")["path"] == Path("home")
    assert options(moved, "c")["path"] == Path("home/today")


def test_a_parameter_keeps_its_type_and_is_written_out_inside_text(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        """
        overflight: 1
        graph: parameters
        parameters: {rate: 20, name: "$folder/${part}_1", folder: a$$b, part: x, odd: $name}
        stages:
          camera: {use: graph_stages:Camera, options: {rate_hz: $rate}}
          lidar: {use: graph_stages:Lidar, options: {path: $odd, rows: $rate}}
        """,
    )
    graph = load(path)
    assert options(graph, "camera") == {"rate_hz": 20.0}
    assert options(graph, "lidar") == {"path": tmp_path / "a$b/x_1", "rows": 20}
    assert graph.parameters["odd"] == "a$b/x_1"


def test_what_stands_in_the_including_file_wins_and_mappings_merge(tmp_path: Path) -> None:
    written(
        tmp_path,
        "stages: {lidar: {use: graph_stages:Lidar, options: {path: a, rows: 8}}}",
        "a.yaml",
    )
    written(tmp_path, "include: [a.yaml]\nstages: {lidar: {options: {rows: 32}}}", "b.yaml")
    path = written(
        tmp_path,
        "overflight: 1\ngraph: g\ninclude: [b.yaml]\nstages: {lidar: {options: {path: mine}}}",
    )
    assert options(load(path), "lidar") == {"path": tmp_path / "mine", "rows": 32}


def test_a_later_overlay_wins_and_settings_win_over_all(tmp_path: Path) -> None:
    one = written(
        tmp_path, "stages: {camera: {options: {rate_hz: 1, delay_ms: 1, jitter_ms: 1}}}", "1.yaml"
    )
    two = written(tmp_path, "stages: {camera: {options: {rate_hz: 2, delay_ms: 2}}}", "2.yaml")
    graph = load(GOOD, "stages.camera.options.rate_hz=3", overlays=[one, two])
    assert options(graph, "camera") == {"rate_hz": 3.0, "delay_ms": 2.0, "jitter_ms": 1.0}


def test_a_setting_reaches_into_an_input_in_short_form() -> None:
    trigger = load(GOOD, "stages.blur.inputs.image.rate_hz=5").topology.stage("blur").trigger
    assert trigger.sources == (Port("camera"),)
    assert trigger.period == 200_000_000


def test_null_in_an_overlay_removes_an_entry_but_is_a_value_among_options(tmp_path: Path) -> None:
    overlay = written(tmp_path, "stages: {save: null, lidar: {options: {rows: 4}}}")
    graph = load(GOOD, "stages.fuse.options=", overlays=[overlay])
    assert "save" not in [stage.name for stage in graph.stages]
    graph = load(GOOD, "stages.save.options.path=null")
    assert options(graph, "save") == {"path": None}


def test_a_key_with_nothing_behind_it_counts_as_not_written(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        "overflight: 1\ngraph: g\nparameters:\ndevices:\n"
        "stages:\n  camera:\n    use: graph_stages:Camera\n    options:\n      # rate_hz: 3\n",
    )
    assert options(load(path), "camera") == {}


def test_mappings_merge_with_the_yaml_merge_key(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        """
        overflight: 1
        graph: g
        stages:
          one: &camera {use: graph_stages:Camera, options: {rate_hz: 5}}
          two: {<<: *camera, min_period_ms: 100}
        """,
    )
    graph = load(path)
    assert options(graph, "two") == {"rate_hz": 5.0}
    assert graph.topology.stage("two").min_period == 100_000_000


@pytest.mark.parametrize(
    ("block", "rig"),
    [
        ("{lidar: 1.5}", Rig({"lidar": 1.5})),
        ("{use: graph_stages:rig_of_folder, options: {path: data/lidar}}", Rig({"lidar": 1.0})),
    ],
)
def test_a_stage_that_asks_for_the_calibration_gets_it(
    tmp_path: Path, block: str, rig: Rig
) -> None:
    path = written(
        tmp_path,
        f"""
        overflight: 1
        graph: g
        calibration: {block}
        stages:
          lidar: {{use: graph_stages:Lidar, options: {{path: x}}}}
          mount: {{use: graph_stages:Mount, inputs: {{scan: lidar}}}}
        """,
    )
    assert options(load(path), "mount") == {"calibration": rig}


def test_a_select_group_and_a_ladder_are_taken_over(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        """
        overflight: 1
        graph: g
        devices: {chip: {use: "graph_stages:Chip"}, spare: {use: "graph_stages:Chip"}}
        stages:
          rgb: {use: graph_stages:Camera}
          one: &detect
            use: graph_stages:Detect
            executor: [chip, spare]
            model: detect-rgb
            on_error: skip
            priority: 3
            max_in_flight: 4
            inputs: {image: {from: rgb/out, select: same}}
          two: *detect
        """,
    )
    graph = load(path)
    one, two = graph.topology.stage("one"), graph.topology.stage("two")
    assert one.trigger == two.trigger == Input("image", (Port("rgb"),), select="same")
    assert graph.stage("one").ladder == ("chip", "spare")
    assert (one.on_error.value, one.priority, one.max_in_flight) == ("skip", 3, 4)


def test_a_defect_of_a_stage_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: Lidar, *, path: Path, rows: int = 1) -> None:
        raise RuntimeError("a defect")

    monkeypatch.setattr(Lidar, "__init__", broken)
    with pytest.raises(RuntimeError, match="a defect"):
        load()


def test_graph_error_lists_mistakes_in_the_order_of_the_files(tmp_path: Path) -> None:
    overlay = written(tmp_path, "stages:\n  camera: {options: {rate_hz: x}}\n")
    with pytest.raises(GraphError) as caught:
        load(GOOD, "stages.blur.priority=x", "stages.fuse.use=nowhere", overlays=[overlay])
    assert [mistake.file for mistake in caught.value.mistakes] == [
        str(overlay),
        "--set stages.blur.priority",
        "--set stages.fuse.use",
    ]
    assert caught.value.mistakes[0].line == 2
