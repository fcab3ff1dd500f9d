from __future__ import annotations

from pathlib import Path

import pytest
from graph_stages import Models

from pipeline.errors import GraphError
from pipeline.graph.graph import load_graph

PAGE = Path(__file__).parent / "wrong_graphs"


@pytest.fixture(autouse=True)
def _beside_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(PAGE)


def mistakes(file: str | Path, *settings: str, overlays: tuple[Path, ...] = ()) -> list[str]:
    with pytest.raises(GraphError) as caught:
        load_graph(Path(file), catalog=Models(), settings=settings, overlays=overlays)
    return [str(mistake) for mistake in caught.value.mistakes]


@pytest.mark.parametrize("file", sorted(path.name for path in PAGE.glob("*.yaml")))
def test_a_wrong_graph_says_exactly_what_is_written_at_its_end(file: str) -> None:
    expected = [
        line.removeprefix("#: ")
        for line in Path(file).read_text(encoding="utf-8").splitlines()
        if line.startswith("#: ")
    ]
    assert expected
    assert mistakes(file) == expected


def test_the_page_has_at_least_25_wrong_graphs() -> None:
    assert len(list(PAGE.glob("*.yaml"))) >= 25


def test_a_missing_file_is_named_with_its_likeliest_neighbor() -> None:
    assert mistakes("circel.yaml") == ["circel.yaml: no such file; did you mean 'circle.yaml'?"]


def test_a_folder_is_no_graph_file() -> None:
    assert mistakes("parts") == ["parts: cannot be read: is a directory"]


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "photo.yaml"
    file.write_bytes(b"\xff\xd8\xff\xe0")
    assert mistakes(file) == [f"{file}: is no text in UTF-8"]


def test_a_control_character_is_pointed_at(tmp_path: Path) -> None:
    file = tmp_path / "graph.yaml"
    file.write_bytes(b"overflight: 1\ngraph: te\x07st\n")
    assert mistakes(file) == [f"{file}:2:10: not YAML: a control character"]


def test_a_file_that_is_far_too_long_is_not_read(tmp_path: Path) -> None:
    file = tmp_path / "graph.yaml"
    file.write_text("a: 1\n" * 300_000)
    assert mistakes(file) == [f"{file}: is more than 1,000,000 bytes long; is it a graph file?"]


def test_settings_are_places_of_their_own() -> None:
    assert mistakes(
        "../good_graph.yaml",
        "stages.camera.options.rate_hz=fast",
        "stages.camera.option.rate_hz=3",
        "stages.blur.inputs.image=cam",
        "parameters.rat=4",
        "parameters.rate=quick",
        "include=[x.yaml]",
        "stages.blur.priority=[1",
        "stages..x=1",
        "just words",
    ) == [
        "--set include: 'include' cannot be set; use an overlay file",
        "--set stages.blur.priority: not YAML: a '[' is opened and never closed, or a ',' is "
        "missing",
        "--set stages..x: a setting looks like stages.rgb.options.rate_hz=10",
        "--set just words: a setting looks like stages.rgb.options.rate_hz=10",
    ]
    assert mistakes(
        "../good_graph.yaml",
        "stages.camera.option.rate_hz=3",
        "stages.blur.inputs.image=camra",
        "parameters.rat=4",
        "parameters.rate=quick",
    ) == [
        "../good_graph.yaml:11:24: stages.camera.options.rate_hz: expected a number, got 'quick' "
        "(from $rate, --set parameters.rate)",
        "--set stages.camera.option.rate_hz: stages.camera.option: unknown key 'option'; did you "
        "mean 'options'?",
        "--set stages.blur.inputs.image: no stage 'camra'; did you mean 'camera'?",
        "--set parameters.rat: the graph has no parameter 'rat'; did you mean 'rate'?",
    ]


def test_a_mistake_in_an_overlay_is_placed_in_the_overlay(tmp_path: Path) -> None:
    overlay = tmp_path / "at_home.yaml"
    overlay.write_text("stages:\n  camera:\n    options: {rate_hz: many}\n")
    assert mistakes("../good_graph.yaml", overlays=(overlay,)) == [
        f"{overlay}:3:24: stages.camera.options.rate_hz: expected a number, got 'many'"
    ]


def test_files_that_include_each_other_are_named_in_order(tmp_path: Path) -> None:
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    first.write_text("overflight: 1\ngraph: loop\ninclude: [second.yaml]\n")
    second.write_text("include:\n  - first.yaml\n")
    assert mistakes(first) == [
        f"{second}:2:5: include[0]: files include each other in a circle: "
        f"{first} -> {second} -> {first}"
    ]


def test_an_include_that_doubles_at_every_level_is_stopped(tmp_path: Path) -> None:
    for level in range(12):
        (tmp_path / f"{level}.yaml").write_text(f"include: [{level + 1}.yaml, {level + 1}.yaml]\n")
    (tmp_path / "12.yaml").write_text("parameters: {}\n")
    assert "more than 64 files are included" in mistakes(tmp_path / "0.yaml")[0]


def test_parameters_that_grow_from_each_other_are_stopped(tmp_path: Path) -> None:
    file = tmp_path / "graph.yaml"
    for wide in (
        "[$p{0}, $p{0}, $p{0}, $p{0}, $p{0}, $p{0}, $p{0}, $p{0}]",
        "'$p{0}$p{0}$p{0}$p{0}'",
    ):
        lines = [f"  p{number + 1}: {wide.format(number)}" for number in range(20)]
        file.write_text("parameters:\n  p0: lidar\n" + "\n".join(lines) + "\n")
        assert len(mistakes(file)) < 50


def test_a_long_chain_of_parameters_is_stopped(tmp_path: Path) -> None:
    file = tmp_path / "graph.yaml"
    lines = [f"  p{number}: $p{number + 1}" for number in range(5000)]
    file.write_text("parameters:\n" + "\n".join(lines) + "\n")
    assert "parameters refer to each other too deep" in "\n".join(mistakes(file))
